"""`flying-vines run`: the service, with its screen, recorder and gateway.

`demo`: a scripted flight with a fake vehicle and a simulated rig. `watch`: a running service on this
terminal.
"""

from __future__ import annotations

import argparse
import asyncio
import gc
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flying_vines.cli.common import FLIGHT_LOGS, FLIGHTS, add_option, fail, file_errors

if TYPE_CHECKING:
    from rich.console import Console

    from flying_vines.config.config import Config
    from flying_vines.service.persistent_state import PersistentState

URL_HERE = "http://127.0.0.1:8017"


class WatchError(Exception):
    """The service cannot be watched; the text is one line: why, and what to do."""


def add(commands: Any) -> None:
    """Add `run` to the parsers of the command line."""
    run = commands.add_parser("run", help="run the service for a vehicle and a phloSAR")
    add_option(run, "--config", required=True, help="the configuration")
    add_option(run, "--rig")
    add_option(run, "--cause")
    add_option(run, "--out", **FLIGHT_LOGS)
    add_option(run, "--plain")
    run.set_defaults(run=_run)


def _run(arguments: argparse.Namespace) -> int:
    # Each full collection takes 20 ms and frees little during the start. `serve` enables collection again.
    gc.disable()
    from flying_vines.gateway.page_token import PageTokenError
    from flying_vines.record.recorder import FlightStart, Recorder
    from flying_vines.service.runner import Remembered, serve
    from flying_vines.service.starting import read_inputs
    from flying_vines.terminal.screen import NonBlockingOutput

    read = read_inputs(arguments.config, arguments.rig)
    config, known, state = read.config, read.known, read.state
    with file_errors(arguments.config, PageTokenError):
        remembered = Remembered(state, read.stored, read.signing, state.read_page_token(config))
    try:
        numbers = known.prior.pneumatics if known else config.pneumatics
        began = FlightStart(read.text, numbers, read.rig_text, remembered.stored)
        log = Recorder(arguments.out, began, config.log.least_free_MB)
    except OSError as error:
        fail(f"{arguments.out}: no flight log can be written there: {error.strerror}")
    output = NonBlockingOutput()
    console = output.console()
    links = f"Vehicle {config.vehicle.link}, {config.firmware.name} {config.firmware.link}"
    console.print(f"{links}, log {log.folder}", soft_wrap=True)
    lines = [f"Vehicle link {config.vehicle.who_can_command}"]
    if known:
        lines.append(f"Rig {known.path}: {known.summary}")
    parameters = remembered.stored.parameters
    lines += [f"Parameter {parameter} = {value:g}" for parameter, value in parameters.items()]
    lines += read.notes
    page = _page_line(config, state, remembered.page_token, console) if config.page.port else ""
    if page:
        lines.append(page)
    for line in lines:
        console.print(line, soft_wrap=True)
    prior = known.prior if known else None
    asyncio.run(serve(config, prior, remembered, log, console, live=not arguments.plain, page=page))
    if log.failed:
        console.print(log.failed)
    console.print("Vented. Stopped.")
    output.close()
    return 0


def _page_line(config: Config, state: PersistentState, page_token: str, console: Console) -> str:
    """The page's address. Its token is shown only on a terminal, because others may read a log."""
    from flying_vines.gateway.page_token import address, watching

    if page_token and not console.is_terminal:
        return f"Page {address(config.page)}, token in {state.page_token}"
    if page_token:
        only_watches = f"; to watch only: token {watching(page_token)}"
        return f"Page {address(config.page, page_token)}{only_watches}"
    return f"Page {address(config.page)}"


def add_demo(commands: Any) -> None:
    """Add `demo` to the parsers of the command line."""
    demo = commands.add_parser("demo", help="fly a scripted flight, with a fake vehicle and rig")
    add_option(demo, "--out", default=FLIGHTS, help=f"the folder for the flight ({FLIGHTS})")
    add_option(demo, "--plain")
    add_option(demo, "--rig", help="simulated rig (default: a typical vine)")
    demo.add_argument("--page", action="store_true", help="also serve the status page for a browser")
    add_option(demo, "--cause")
    demo.set_defaults(run=_demo)


def _demo(arguments: argparse.Namespace) -> int:
    from rich.console import Console

    from flying_vines.core.instability import LATE_S
    from flying_vines.physics.plant.true_rig import load_true_rig
    from flying_vines.physics.rig import RigError
    from flying_vines.simulation.demo import fly, summary
    from flying_vines.terminal.screen import can_redraw

    console = Console(markup=False)
    live = can_redraw(console) and not arguments.plain
    with file_errors(arguments.out, RigError):
        rig = load_true_rig(arguments.rig) if arguments.rig else None
        flight = asyncio.run(fly(arguments.out, console, live, rig, arguments.page))
    console.print(summary(flight))
    for extra in flight.unexpected_triggers:
        console.print(f"Unexpected: {extra}", style="bold red")
    seen = ", ".join(f"{name} {value:.1f}" for name, value in sorted(flight.values.items()))
    console.print(f"\nThe ground station's last values: {seen}", highlight=False)
    console.print(f"Log      {flight.folder}", highlight=False, soft_wrap=True)
    if flight.picture:
        console.print(f"Picture  {flight.picture}", highlight=False, soft_wrap=True)
    console.print("Everything went as it should." if flight.passed else "The flight FAILED.", style="bold")
    if not flight.passed and flight.late_s >= LATE_S:
        console.print(
            f"This computer was too busy: up to {flight.late_s:.1f} s late. Try again when it has less to do."
        )
    return 0 if flight.passed else 1


def add_watch(commands: Any) -> None:
    """Add `watch` to the parsers of the command line."""
    watch = commands.add_parser("watch", help="show a running service on this terminal")
    watch.add_argument("--url", default=URL_HERE, help=f"the service's page ({URL_HERE})")
    watch.add_argument(
        "--token-file", type=Path, metavar="FILE", help="the page's token, if the page needs one"
    )
    add_option(watch, "--seconds", help="stop after this time; exit status 1 without data")
    add_option(watch, "--plain")
    add_option(watch, "--json", help="print each message of the page as a JSON object")
    watch.set_defaults(run=_watch)


def _watch(arguments: argparse.Namespace) -> int:
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
