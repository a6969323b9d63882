"""`flying-vines run`: the service, with its screen, recorder and gateway."""

from __future__ import annotations

import argparse
import asyncio
import gc
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flying_vines.cli.common import FLIGHTS, add_cause_option, fail, file_errors

if TYPE_CHECKING:
    from rich.console import Console

    from flying_vines.config.config import Config
    from flying_vines.service.persistent_state import PersistentState


def add(commands: Any) -> None:
    """Add `run` to the parsers of the command line."""
    run = commands.add_parser("run", help="run the service for a vehicle and a phloSAR")
    run.add_argument("--config", type=Path, required=True, metavar="FILE", help="the configuration")
    run.add_argument("--rig", type=Path, metavar="RIG.toml", help="the rig (default: the configuration's)")
    add_cause_option(run)
    run.add_argument(
        "--out", type=Path, default=FLIGHTS, metavar="DIR", help="the folder for flight logs (flights)"
    )
    run.add_argument("--plain", action="store_true", help="print lines instead of the live view")
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
