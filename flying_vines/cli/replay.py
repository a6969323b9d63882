"""`flying-vines replay`: runs the core on a recording and prints its decisions."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from flying_vines.cli.common import add_option, fail, file_errors, read_mission, rig_file_prior
from flying_vines.config import config as configuration

if TYPE_CHECKING:
    from flying_vines.config.config import Config
    from flying_vines.core.events import Action
    from flying_vines.simulation.replay import FlightReplay

DIFFERENT = 1
MAX_DIFFERENCES = 10


def add(commands: Any) -> None:
    """Add `replay` to the parsers of the command line."""
    replay = commands.add_parser("replay", help="run the service's logic on a recording")
    replay.add_argument(
        "recording",
        type=Path,
        metavar="FILE",
        help="a .tlog; or a flight: its folder, its .mcap, or DIR/last",
    )
    add_option(replay, "--config")
    add_option(replay, "--mission", help="the mission, if the recording has none")
    replay.add_argument(
        "--parameters", type=Path, metavar="FILE.toml", help="the parameters that a pilot had set"
    )
    replay.add_argument(
        "--system",
        type=int,
        metavar="N",
        help="the vehicle, by its system id (default: the configuration's, or the only one)",
    )
    replay.add_argument(
        "--pace", type=float, default=0.0, metavar="N", help="1: as recorded; 0: as fast as possible (0)"
    )
    add_option(replay, "--cause")
    add_option(replay, "--json", help="print a JSON array instead")
    replay.set_defaults(run=_replay)


def _replay(arguments: argparse.Namespace) -> int:
    from flying_vines.core.events import Decision
    from flying_vines.record.reader import is_flight
    from flying_vines.simulation.replay import as_json, replay
    from flying_vines.vehicle.component.parameter_file import ParameterFileError
    from flying_vines.vehicle.component.parameter_file import read as read_parameters
    from flying_vines.vehicle.mavlink.tlog import TlogError, TlogReader

    recording: Path = arguments.recording
    if recording.is_dir() or is_flight(recording):
        if arguments.mission or arguments.parameters or arguments.pace or arguments.system is not None:
            fail("--mission, --parameters, --system and --pace are for a .tlog, not for a flight log")
        return _replay_flight(recording, arguments.config, arguments.json)
    config = configuration.load_or_default(arguments.config)
    known = rig_file_prior(config, arguments.config)
    mission = read_mission(arguments.mission)
    if not arguments.pace >= 0.0:
        fail("--pace must not be below 0")
    parameters: dict[str, float] = {}
    if arguments.parameters:
        with file_errors(arguments.parameters, ParameterFileError):
            parameters = read_parameters(arguments.parameters, config)
    said: list[str] = []
    try:
        reader = TlogReader(recording)
        frames = list(reader.frames())
        config = _for_vehicle(config, arguments.system, frames, recording, said.append)
        prior = known.prior if known else None
        actions = replay(
            *(frames, config, mission, arguments.pace), prior=prior, parameters=parameters, say=said.append
        )
        show = _action_printer(live=arguments.pace > 0.0 and not arguments.json)
        decisions: list[Decision] = []
        for action in actions:
            show(action)
            if isinstance(action, Decision):
                decisions.append(action)
    except TlogError as error:
        fail(str(error))
    if arguments.json:
        print(json.dumps([as_json(decision) for decision in decisions], indent=1))
    else:
        from rich.console import Console

        from flying_vines.terminal.screen import decision_table

        Console(markup=False).print(decision_table(decisions))
    if reader.skipped_bytes:
        said.append(f"{reader.skipped_bytes} bytes are not part of a MAVLink frame")
    for sentence in said:
        print(f"flying-vines: {recording}: {sentence}", file=sys.stderr)
    return 0


def _for_vehicle(
    config: Config,
    system: int | None,
    frames: Sequence[tuple[float, bytes]],
    recording: Path,
    say: Callable[[str], None],
) -> Config:
    """The configuration for one of the recorded vehicles; fails if there is none or a choice is needed."""
    from flying_vines.simulation.replay import autopilots_in
    from flying_vines.vehicle.state import CHOOSING_S

    found = autopilots_in(frames)
    first, *others = found or [0]
    ids = ", ".join(map(str, found))
    wanted = config.vehicle.system_id if system is None else system
    if not found:
        fail(f"{recording}: has no HEARTBEAT of an autopilot, so there is nothing to replay")
    if wanted and wanted not in found:
        named = f"--system is {system}" if system is not None else f"vehicle.system_id is {wanted}"
        fail(f"{recording}: {named}, but the recording has autopilot {ids}: give --system {first}")
    # As the service does, it keeps the first autopilot if others come later.
    if not wanted and any(abs(found[other] - found[first]) <= CHOOSING_S for other in others):
        fail(f"{recording}: has several autopilots, {ids}: choose one, for example --system {first}")
    if others:
        say(f"has several autopilots, {ids}; this is {wanted or first}; --system N shows another one")
    replace = msgspec.structs.replace
    return replace(config, vehicle=replace(config.vehicle, system_id=wanted))


def _replay_flight(recording: Path, config: Path | None, as_json: bool) -> int:
    """Replay a flight log. Exit status 1 if the core's answers differ from the flight's."""
    from flying_vines.record.reader import FlightLog, LogError, refuses_foreign
    from flying_vines.simulation.replay import replay_flight

    instead = configuration.load(config) if config else None
    with file_errors(recording, LogError), refuses_foreign(log := FlightLog(recording)):
        replay = replay_flight(log, instead)
    _show_replay(replay, as_json)
    if replay.damage:
        print(f"flying-vines: {replay.damage}", file=sys.stderr)
    return DIFFERENT if replay.differences else 0


def _show_replay(replay: FlightReplay, json_wanted: bool) -> None:
    """The replay's decisions, and its differences from the flight."""
    from rich.console import Console

    from flying_vines.simulation.replay import as_json
    from flying_vines.terminal.screen import decision_table

    if json_wanted:
        decisions = [as_json(decision) for decision in replay.decisions]
        print(
            json.dumps({"decisions": decisions, "same": replay.compared, "differences": replay.differences})
        )
        return
    console = Console(markup=False)
    console.print(decision_table([replace(d, t=d.t - replay.began) for d in replay.decisions]))
    for difference in replay.differences[:MAX_DIFFERENCES]:
        console.print(difference, style="red", highlight=False, soft_wrap=True)
    same = ", ".join(f"{count} {topic}" for topic, count in sorted(replay.compared.items()))
    if replay.differences:
        console.print(f"{len(replay.differences)} answers differ from the flight's; identical: {same}")
    else:
        console.print(f"Identical to the flight: {same}", highlight=False)


def _action_printer(live: bool) -> Callable[[Action], None]:
    """Prints each action at once if `live`; otherwise prints nothing."""
    if not live:
        return lambda action: None
    from rich.console import Console

    from flying_vines.terminal.screen import plain_printer

    return plain_printer(Console(markup=False), 0.0)
