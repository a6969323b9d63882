"""`flying-vines demo`: a scripted flight with a fake vehicle and a simulated rig."""

from __future__ import annotations

import argparse
import asyncio
from pathlib import Path
from typing import Any

from flying_vines.cli.common import FLIGHTS, add_cause_option, file_errors


def add(commands: Any) -> None:
    """Add `demo` to the parsers of the command line."""
    demo = commands.add_parser("demo", help="fly a scripted flight, with a fake vehicle and rig")
    demo.add_argument(
        "--out", type=Path, default=FLIGHTS, metavar="DIR", help="the folder for the flight (flights)"
    )
    demo.add_argument("--plain", action="store_true", help="print lines instead of the live view")
    demo.add_argument("--rig", type=Path, metavar="RIG.toml", help="simulated rig (default: a typical vine)")
    demo.add_argument("--page", action="store_true", help="also serve the status page for a browser")
    add_cause_option(demo)
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
