"""`flying-vines watch`: what it is given, and with which status it ends."""

from __future__ import annotations

import argparse
import asyncio
from pathlib import Path
from typing import Any

URL_HERE = "http://127.0.0.1:8017"


class WatchError(Exception):
    """It cannot be watched; the text is one line that says why and what to do."""


def add(commands: Any) -> None:
    """Add `watch` to the parsers of the command line."""
    watch = commands.add_parser("watch", help="a running service on this terminal, by its page")
    watch.add_argument("--url", default=URL_HERE, help=f"of its page ({URL_HERE})")
    watch.add_argument("--token-file", type=Path, metavar="FILE", help="where the page needs its token")
    watch.add_argument("--seconds", type=float, metavar="N", help="then end; with status 1 if it was silent")
    watch.add_argument("--plain", action="store_true", help="one line an event instead of the live view")
    watch.add_argument("--json", action="store_true", help="one object a line: all that the page is told")
    watch.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """0 where the service was heard, 1 where not; `WatchError` where going on is of no use."""
    from flying_vines.gateway import page_token
    from flying_vines.terminal.line import NotAdmittedError, socket_of
    from flying_vines.terminal.watching import Watching

    if arguments.seconds is not None and not arguments.seconds > 0.0:
        raise WatchError("--seconds must be above 0")
    try:
        token = page_token.read(arguments.token_file) if arguments.token_file else ""
        watching = Watching(socket_of(arguments.url), token, arguments.plain, arguments.json)
        return 0 if asyncio.run(watching.run(arguments.seconds)) else 1
    except page_token.PageTokenError as error:
        raise WatchError(str(error)) from None
    except ValueError as error:
        raise WatchError(f"--url {arguments.url}: {error}") from None
    except NotAdmittedError as error:
        raise WatchError(f"{arguments.url}: {error}") from None
