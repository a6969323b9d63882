"""`flying-vines fake`: runs a simulated autopilot or phloSAR alone."""

from __future__ import annotations

import argparse
import asyncio
import sys
from collections.abc import Callable
from pathlib import Path
from time import time
from typing import Any

from flying_vines.cli.common import add_option, fail, read_mission


def add(commands: Any) -> None:
    """Add `fake` to the parsers of the command line."""
    fake = commands.add_parser("fake", help="run a simulated autopilot or phloSAR alone")
    fakes = fake.add_subparsers(required=True, metavar="WHAT")
    autopilot = fakes.add_parser("autopilot", help="simulate an autopilot on UDP")
    autopilot.add_argument(
        "--kind",
        choices=("ardupilot", "px4"),
        default="ardupilot",
        help="the simulated autopilot (ardupilot)",
    )
    companion = "127.0.0.1:14540"
    autopilot.add_argument(
        "--to", default=companion, metavar="HOST:PORT", help=f"the companion's address ({companion})"
    )
    autopilot.add_argument("--gcs", metavar="HOST:PORT", help="also send to a ground station")
    add_option(autopilot, "--mission", help="the stored mission")
    autopilot.add_argument(
        "--fly", action="store_true", help="after 3 s, fly the mission, or take off if there is none"
    )
    autopilot.set_defaults(run=_fake_autopilot)
    phlosar = fakes.add_parser("phlosar", help="simulate a phloSAR on a pseudo-terminal; prints its path")
    phlosar.add_argument("--link", type=Path, metavar="PATH", help="make this symbolic link to the port")
    add_option(phlosar, "--reservoir-kPa", default=690.0, help="reservoir pressure, gauge (690)")
    add_option(phlosar, "--rig", help="the simulated rig (default: a typical vine)")
    phlosar.add_argument(
        "--telemetry-Hz",
        type=int,
        default=100,
        metavar="N",
        help="telemetry rate; use 1000 for a diagnosis (100)",
    )
    add_option(phlosar, "--cause")
    phlosar.set_defaults(run=_fake_phlosar)


def _fake_autopilot(arguments: argparse.Namespace) -> int:
    from flying_vines.simulation.autopilot import FakeAutopilot
    from flying_vines.simulation.autopilot_server import AutopilotServer
    from flying_vines.simulation.typed_commands import HELP, obey, type_to

    mission = read_mission(arguments.mission)
    script: list[tuple[float, Callable[[FakeAutopilot], None]]] = []
    if arguments.fly:
        fly = FakeAutopilot.start_mission if mission else lambda autopilot: autopilot.takeoff(10.0)
        script.append((3.0, fly))
    try:
        autopilot = FakeAutopilot(arguments.kind, mission=mission, unix_s=time())
        gcs = f"udpout:{arguments.gcs}" if arguments.gcs else None
        server = AutopilotServer(autopilot, f"udpout:{arguments.to}", gcs, script)
    except ValueError as error:
        fail(str(error))

    async def serve() -> None:
        print(f"A fake {arguments.kind} sends to {arguments.to}. Type to fly it; Ctrl-C ends it.", flush=True)
        print(HELP, flush=True)
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(server.run())
            tasks.create_task(type_to(lambda line: obey(autopilot, line)))

    taken: BaseException | None = None
    try:
        asyncio.run(serve())
    except* OSError as group:
        taken = group.exceptions[0]
    if taken is not None:
        fail(str(getattr(taken, "strerror", None) or taken))
    return 0


def _fake_phlosar(arguments: argparse.Namespace) -> int:
    from flying_vines.physics.plant.true_rig import load_true_rig
    from flying_vines.physics.rig import RigError
    from flying_vines.simulation.phlosar.phlosar import PtyPhlosar, SimulatedPhlosar
    from flying_vines.simulation.typed_commands import MISHAPS, inject_typed, type_to

    if not 10 <= arguments.telemetry_Hz <= 1000:
        fail("--telemetry-Hz must be from 10 to 1000")
    try:
        rig = load_true_rig(arguments.rig) if arguments.rig else None
        settings = {"telemetry_Hz": arguments.telemetry_Hz}
        phlosar = SimulatedPhlosar(rig, settings, reservoir_kPa=arguments.reservoir_kPa)
        with PtyPhlosar(phlosar, arguments.link) as port:

            async def live() -> None:
                print(port.path, flush=True)
                if sys.stdin.isatty():
                    print("Type a failure to simulate, e.g. `hose off` or `evp stuck 1`; Ctrl-C ends it.")
                    print(MISHAPS, flush=True)
                await asyncio.gather(port.run(), type_to(lambda line: inject_typed(phlosar, line)))

            asyncio.run(live())
    except RigError as error:
        fail(str(error))
    except OSError as error:
        fail(f"{arguments.link or 'the pseudo-terminal'}: {error.strerror or error}")
    return 0
