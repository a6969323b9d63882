"""`flying-vines watch`: shows a running service on this terminal."""

from __future__ import annotations

import argparse
import asyncio
from pathlib import Path
from typing import Any

URL_HERE = "http://127.0.0.1:8017"


class WatchError(Exception):
    """The service cannot be watched; the text is one line: why, and what to do."""


def add(commands: Any) -> None:
    """Add `watch` to the parsers of the command line."""
    watch = commands.add_parser("watch", help="show a running service on this terminal")
    watch.add_argument("--url", default=URL_HERE, help=f"the service's page ({URL_HERE})")
    watch.add_argument(
        "--token-file", type=Path, metavar="FILE", help="the page's token, if the page needs one"
    )
    watch.add_argument(
        "--seconds", type=float, metavar="N", help="stop after this time; exit status 1 without data"
    )
    watch.add_argument("--plain", action="store_true", help="print lines instead of the live view")
    watch.add_argument("--json", action="store_true", help="print each message of the page as a JSON object")
    watch.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Returns 0 if the service sent data, else 1. Raises `WatchError` if a retry cannot help."""
    from flying_vines.gateway import page_token
    from flying_vines.terminal.page_socket import NotAdmittedError, socket_of
    from flying_vines.terminal.remote_view import RemoteView

    if arguments.seconds is not None and not arguments.seconds > 0.0:
        raise WatchError("--seconds must be above 0")
    try:
        token = page_token.read(arguments.token_file) if arguments.token_file else ""
        view = RemoteView(socket_of(arguments.url), token, arguments.plain, arguments.json)
        return 0 if asyncio.run(view.run(arguments.seconds)) else 1
    except page_token.PageTokenError as error:
        raise WatchError(str(error)) from None
    except ValueError as error:
        raise WatchError(f"--url {arguments.url}: {error}") from None
    except NotAdmittedError as error:
        raise WatchError(f"{arguments.url}: {error}") from None
