"""`flying-vines mission`: build, check, upload, watch, download, script."""

from __future__ import annotations

import argparse
import asyncio
import json
import re
from collections.abc import Callable, Coroutine
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from flying_vines.cli.common import BAD_INPUT, add_option, bad_input, fail, file_errors, rig_file_prior
from flying_vines.config.address import FORMS

if TYPE_CHECKING:
    from rich.console import Console

    from flying_vines.config.config import Config
    from flying_vines.vehicle.mission.item import AutopilotKind, MissionItem
    from missions.home import Home
    from missions.report import Report

NOT_AS_PLANNED = 1
SCRIPT = "vine_items.lua"
EXAMPLES = ("bridge_inspection", "canopy_sampling")
"""Missions that come with the program."""
_NEGATIVE = re.compile(r"-\.?\d")
GROUND_STATION_LINK = "udpin:0.0.0.0:14550"


def add(commands: Any) -> None:
    """Add `mission` to the parsers of the command line."""
    mission = commands.add_parser("mission", help="missions with vine items: build, check, upload, watch")
    actions = mission.add_subparsers(required=True, metavar="ACTION")

    build = actions.add_parser("build", help="make a .plan and a .waypoints for one autopilot from a text")
    build.add_argument("mission", type=Path, metavar="MISSION.toml", help="the mission as text")
    add_option(build, "--out", metavar="PATH", help="a folder, or one file (default: the mission's folder)")
    _common(build)
    build.set_defaults(run=_build)

    check = actions.add_parser("check", help="find errors in a mission, and the air that it needs")
    check.add_argument("mission", type=Path, metavar="FILE", help="a .toml, .plan or .waypoints")
    check.add_argument("--fly", action="store_true", help="also fly it in simulation")
    _common(check)
    check.set_defaults(run=_check)

    upload = actions.add_parser("upload", help="write a mission to the vehicle, and read it back")
    upload.add_argument("mission", type=Path, metavar="FILE", help="a .plan or .waypoints")
    _vehicle(upload, _upload)
    watch = actions.add_parser("watch", help="follow the flown mission to its end")
    add_option(watch, "--plain")
    _vehicle(watch, _watch)
    download = actions.add_parser("download", help="read the mission from the vehicle")
    download.add_argument("mission", type=Path, metavar="FILE", help="a .plan or .waypoints to write")
    _vehicle(download, _download)
    example = actions.add_parser("example", help="write an example mission as text")
    example.add_argument("name", choices=EXAMPLES, metavar="NAME", help=" or ".join(EXAMPLES))
    add_option(example, "--out", metavar="FILE.toml", help="the file (NAME.toml)")
    example.set_defaults(run=_example)
    script = actions.add_parser("script", help="write the Lua script that sends vine items on ArduPilot")
    add_option(script, "--out", default=Path(SCRIPT), metavar="FILE.lua", help=f"the file ({SCRIPT})")
    script.set_defaults(run=_script)


def _common(parser: argparse.ArgumentParser) -> None:
    # Before Python 3.14, argparse takes a place in the south or west ("-35.36,149.16,584") for an option.
    parser._negative_number_matcher = _NEGATIVE
    add_option(parser, "--config")
    parser.add_argument("--autopilot", choices=("ardupilot", "px4"), help="(default: the mission's own)")
    parser.add_argument(
        "--home",
        type=_home,
        metavar="LAT,LON,ALT",
        help="degrees, and metres above sea level; replaces the file's home",
    )
    add_option(
        parser,
        "--reservoir-kPa",
        type=_pressure,
        help="reservoir pressure at the start, gauge (default: full)",
    )
    add_option(parser, "--rig")
    add_option(parser, "--cause")
    add_option(parser, "--json")


def _vehicle(parser: argparse.ArgumentParser, run: Callable[[argparse.Namespace], int]) -> None:
    parser.add_argument(
        "--link", default=GROUND_STATION_LINK, metavar="LINK", help=f"{FORMS} ({GROUND_STATION_LINK})"
    )
    parser.set_defaults(run=run)


def _upload(arguments: argparse.Namespace) -> int:
    from missions.transfer import upload

    return _on_vehicle(upload(arguments.mission, arguments.link, _console()))


def _watch(arguments: argparse.Namespace) -> int:
    from flying_vines.terminal.screen import can_redraw
    from missions.watch import watch

    console = _console()
    live = can_redraw(console) and not arguments.plain
    return _on_vehicle(watch(arguments.link, console, live))


def _download(arguments: argparse.Namespace) -> int:
    from missions.transfer import download

    return _on_vehicle(download(arguments.mission, arguments.link, _console()))


def _example(arguments: argparse.Namespace) -> int:
    out: Path = arguments.out or Path(f"{arguments.name}.toml")
    # A pilot edits the file: a second call must not overwrite it.
    _write_shipped("examples", f"{arguments.name}.toml", out, "xb")
    print(f"{out}: build it with `flying-vines mission build {out}`")
    return 0


def _script(arguments: argparse.Namespace) -> int:
    _write_shipped("ardupilot", SCRIPT, arguments.out)
    print(
        f"{arguments.out}: copy it to APM/scripts on the autopilot's SD card; set SCR_ENABLE 1, then reboot"
    )
    return 0


def _write_shipped(folder: str, name: str, out: Path, mode: Literal["wb", "xb"] = "wb") -> None:
    """Write a file that comes with the program; "xb" keeps an existing file, and fails."""
    shipped = resources.files("missions").joinpath(folder, name)
    with file_errors(out), out.open(mode) as file:
        file.write(shipped.read_bytes())


def _on_vehicle(work: Coroutine[None, None, int]) -> int:
    from missions.link import VehicleLinkError
    from missions.mission import MissionError

    try:
        return asyncio.run(work)
    except (VehicleLinkError, MissionError) as error:
        return bad_input(str(error))


def _console() -> Console:
    from rich.console import Console

    return Console(markup=False, highlight=False)


def _home(text: str) -> Home:
    from missions.home import Home

    try:
        latitude, longitude, altitude_m = map(float, text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not LAT,LON,ALT") from None
    if not (abs(latitude) <= 90 and abs(longitude) <= 180 and -500 <= altitude_m <= 9000):
        raise argparse.ArgumentTypeError(f"{text!r} is not a place on earth")
    return Home(latitude, longitude, altitude_m)


def _pressure(text: str) -> float:
    try:
        pressure_kPa = float(text)
    except ValueError:
        pressure_kPa = -1.0
    if not 0.0 <= pressure_kPa <= 2000.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a pressure from 0 to 2000 kPa gauge")
    return pressure_kPa


def _build(arguments: argparse.Namespace) -> int:
    from missions.mission import MissionError
    from missions.plan_file import write_plan
    from missions.waypoints import write_waypoints

    path: Path = arguments.mission
    if path.suffix.casefold() in (".plan", ".waypoints"):
        fail(f"{path}: is already a built mission; check it with `flying-vines mission check`")
    with file_errors(arguments.out, MissionError):
        report = _report(arguments)
        if report.errors:
            return _tell(report, arguments.json, [])
        written: list[Path] = []
        for target in _targets(arguments.out or path.parent, path.stem, report.kind):
            target.parent.mkdir(parents=True, exist_ok=True)
            if target.suffix.casefold() == ".plan":
                write_plan(target, report.items, report.kind, report.home)
            else:
                write_waypoints(target, report.items)
            written.append(target)
    return _tell(report, arguments.json, written)


def _targets(out: Path, stem: str, kind: AutopilotKind) -> list[Path]:
    if out.suffix.casefold() in (".plan", ".waypoints"):
        return [out]
    return [out / f"{stem}-{kind}{suffix}" for suffix in (".plan", ".waypoints")]


def _check(arguments: argparse.Namespace) -> int:
    from missions.mission import MissionError

    with file_errors(arguments.mission, MissionError):
        report = _report(arguments, flies=arguments.fly)
    status = _tell(report, arguments.json, [])
    return status or (NOT_AS_PLANNED if report.differences else 0)


def _report(arguments: argparse.Namespace, flies: bool = False) -> Report:
    from flying_vines.config import config as configuration
    from flying_vines.supply import nominal
    from missions.report import review

    config = configuration.load_or_default(arguments.config)
    name, items, kind, home = _items(arguments, config)
    known = rig_file_prior(config, arguments.config, arguments.rig)
    prior = known.prior if known else nominal(config.pneumatics)
    reservoir_kPa = arguments.reservoir_kPa
    if reservoir_kPa is None:
        reservoir_kPa = config.pneumatics.full_kPa
    report = review(name, items, kind, home, config, prior, reservoir_kPa)
    if not flies:
        return report
    from flying_vines.physics.plant.true_rig import load_true_rig
    from flying_vines.simulation.simulated_world import with_flight

    return with_flight(report, config, reservoir_kPa, load_true_rig(known.path) if known else None)


def _items(
    arguments: argparse.Namespace, config: Config
) -> tuple[str, list[MissionItem], AutopilotKind, Home]:
    """Name, items, autopilot and home, from a mission text or a built mission."""
    from missions.build import build
    from missions.files import SUFFIXES, load_items
    from missions.mission import MissionError, load, planned_home

    path: Path = arguments.mission
    if path.suffix.casefold() in SUFFIXES:
        if arguments.home:
            raise MissionError(f"{path}: --home is for a .toml; this file already contains positions")
        found = load_items(path, arguments.autopilot)
        return path.stem, list(found.items), found.kind, found.home
    mission, text = load(path)
    kind = arguments.autopilot or mission.autopilot
    if kind is None:
        raise MissionError(
            f'{path}: names no autopilot: write autopilot = "ardupilot" or "px4" in it, or give --autopilot'
        )
    home = arguments.home or planned_home(mission, kind, str(path))
    return mission.name or path.stem, build(mission, config, kind, home, str(path), text), kind, home


def _tell(report: Report, as_json_wanted: bool, written: list[Path]) -> int:
    from rich.console import Console

    from missions.report import as_json, show

    if as_json_wanted:
        files = {"files": [str(path) for path in written]}
        print(json.dumps({**as_json(report), **files}, allow_nan=False))
        return BAD_INPUT if report.errors else 0
    console = Console(markup=False, highlight=False)
    show(report, console)
    for path in written:
        console.print(f"Written  {path}", soft_wrap=True)
    return bad_input("\n".join(finding.text for finding in report.errors)) if report.errors else 0
