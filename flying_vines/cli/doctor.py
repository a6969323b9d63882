"""`flying-vines doctor`: checks whether the vehicle may fly."""

from __future__ import annotations

import argparse
import asyncio
import json
from contextlib import AsyncExitStack
from typing import Any

from flying_vines.cli.common import FLIGHT_LOGS, add_option

MAY_NOT_FLY = 1
SECONDS = 6.0
MIN_SECONDS = 5.0
"""A silent board is reported after 3 s, and streams are requested one after another, some at 1 Hz."""


def add(commands: Any) -> None:
    """Add `doctor` to the parsers of the command line."""
    doctor = commands.add_parser("doctor", help="check whether you may fly; show problems and remedies")
    add_option(doctor, "--config")
    add_option(
        doctor, "--seconds", type=number_of_seconds, default=SECONDS, help=f"listening time ({SECONDS:g})"
    )
    add_option(doctor, "--out", **FLIGHT_LOGS)
    doctor.add_argument(
        "--radio", action="store_true", help="guided test instead: is a lost transmitter detected?"
    )
    add_option(
        doctor,
        "--yes",
        help="no questions: do not ask to move the RC switch; with --radio, write the configuration",
    )
    doctor.add_argument("--fakes", action="store_true", help="check a simulated vehicle and phloSAR instead")
    add_option(doctor, "--json")
    doctor.set_defaults(run=run)


def number_of_seconds(text: str) -> float:
    seconds = float(text)
    if not MIN_SECONDS <= seconds <= 3600.0:
        raise argparse.ArgumentTypeError(f"must be from {MIN_SECONDS:g} to 3600")
    return seconds


def run(arguments: argparse.Namespace) -> int:
    """Returns 0 if you may fly, else 1. Raises `ConfigError` if the configuration cannot be read."""
    if arguments.radio:
        from flying_vines.cli.doctor_radio import test_radio

        return test_radio(arguments)
    return asyncio.run(_run(arguments))


async def _run(arguments: argparse.Namespace) -> int:
    from rich.console import Console

    from flying_vines.config import config as configuration
    from flying_vines.doctor.configuration import given, read
    from flying_vines.doctor.examine import examine
    from flying_vines.doctor.finding import as_json, last_line, may_fly, show, summary
    from flying_vines.doctor.radio import asking
    from flying_vines.doctor.vehicle_probe import SwitchFacts
    from flying_vines.service.starting import check_plugins

    async with AsyncExitStack() as stack:
        if arguments.fakes:
            from flying_vines.cli.doctor_fakes import healthy

            base = configuration.load_or_default(arguments.config)
            config = await stack.enter_async_context(healthy(base))
            examined = given(config, "the configuration with simulated links")
        elif arguments.config:
            examined = read(arguments.config)
        else:
            examined = given(configuration.default(), "the built-in configuration")
        check_plugins(examined.config, arguments.config)
        if arguments.json:
            found = await examine(examined, arguments.out, arguments.seconds, lambda findings: None)
            print(json.dumps(as_json(found), allow_nan=False))
            return 0 if may_fly(found) else MAY_NOT_FLY
        console = Console(markup=False, highlight=False)
        switch = examined.config.switch
        with console.status(f"Listening to both links for {arguments.seconds:g} s") as status:

            def ask(radio: SwitchFacts) -> None:
                status.update(asking(radio, switch.channel, switch.positions))

            found = await examine(
                examined,
                arguments.out,
                arguments.seconds,
                lambda findings: show(findings, console),
                ask if console.is_terminal and not (arguments.yes or arguments.fakes) else None,
            )
    console.print(last_line(found, summary(found)))
    return 0 if may_fly(found) else MAY_NOT_FLY
