"""The commands, thin: parse, call, print. What each needs is imported when it runs."""

from __future__ import annotations

import argparse
import asyncio
import gc
import json
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from time import monotonic, time
from typing import TYPE_CHECKING, Any, NoReturn

from flying_vines import config as configuration
from flying_vines.address import FORMS, parse_address
from flying_vines.bad_input import BAD_INPUT, bad_input, lacks
from flying_vines.calibrate import command as calibrate_command
from flying_vines.config import Config, ConfigError
from flying_vines.doctor import command as doctor_command
from flying_vines.install import command as install_command
from flying_vines.record import command as log_command
from flying_vines.vehicle.mission.item import MissionItem
from flying_vines.watch import command as watch_command
from missions import command as mission_command

if TYPE_CHECKING:
    from rich.console import Console

    from flying_vines.events import Action
    from flying_vines.kept import Kept
    from flying_vines.reservoir.calibration import Calibration

FLIGHTS = Path("flights")
SNAPSHOT_S = 0.05


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """The `flying-vines` command. Exit status 2 and one line on standard error for bad input."""
    arguments = _parser().parse_args(argv)
    try:
        status = arguments.run(arguments)
    except (ConfigError, watch_command.WatchError) as error:
        _fail(str(error))
    except KeyboardInterrupt:
        status = 130
    except BrokenPipeError:
        # Whoever read our output has seen enough; Python's own flush at exit must not complain.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = 0
    sys.exit(status)


def _fail(sentence: str) -> NoReturn:
    sys.exit(bad_input(sentence))


@contextmanager
def _analysis() -> Iterator[None]:
    """What follows needs the extra: one line says so where it is not installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        _fail(lacks(error))
    except ImportError as error:
        _fail(str(error))


@contextmanager
def _files(where: Path | None, *kinds: type[Exception]) -> Iterator[None]:
    """What follows reads and writes files, `where` if the system does not say which: one line for what goes
    wrong, and for errors of these kinds, whose text is one."""
    try:
        yield
    except kinds as error:
        _fail(str(error))
    except OSError as error:
        _fail(f"{error.filename or where}: {error.strerror}")


@contextmanager
def _progress() -> Iterator[Callable[[str, float], None]]:
    """A bar on the terminal while something long works, which tells it what it does and how far it is."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = BarColumn(), TimeElapsedColumn(), TextColumn("{task.description}")
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("reading", total=1.0)
        yield lambda step, share: bar.update(task, description=step, completed=share)


def _show_found(
    as_json: bool,
    found: Callable[[], dict[str, Any]],
    show: Callable[[Console], None],
    figures: Sequence[Path],
) -> int:
    """What was found, as one object or on the terminal, and the figures that were drawn of it."""
    if as_json:
        print(json.dumps({**found(), "figures": [str(path) for path in figures]}, allow_nan=False))
        return 0
    from rich.console import Console

    console = Console()
    show(console)
    for path in figures:
        console.print(f"Figure   {path}", highlight=False, soft_wrap=True)
    return 0


class _Version(argparse.Action):
    """Looked up when asked for: it takes longer than the rest of the parser."""

    def __call__(self, parser: argparse.ArgumentParser, *what: object) -> NoReturn:
        from importlib.metadata import version

        print(f"flying-vines {version('flying-vines')}")
        parser.exit()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="flying-vines", description="A soft robot arm on a drone.")
    parser.add_argument("--version", action=_Version, nargs=0, help="print it and end")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    demo = commands.add_parser("demo", help="fly a scripted flight on embedded fakes")
    demo.add_argument(
        "--out", type=Path, default=FLIGHTS, metavar="DIR", help="where the flight's folder goes (flights)"
    )
    demo.add_argument("--plain", action="store_true", help="one line an event instead of the live view")
    demo.add_argument("--rig", type=Path, metavar="RIG.toml", help="what is there (default: a likely vine)")
    demo.add_argument("--page", action="store_true", help="serve the page, too, for a browser to look on")
    demo.set_defaults(run=_demo)

    run = commands.add_parser("run", help="serve a vehicle and a phloSAR")
    run.add_argument("--config", type=Path, required=True, metavar="FILE", help="the profile")
    run.add_argument("--rig", type=Path, metavar="RIG.toml", help="what is known (default: the profile's)")
    run.add_argument(
        "--out", type=Path, default=FLIGHTS, metavar="DIR", help="where the flight log goes (flights)"
    )
    run.add_argument("--plain", action="store_true", help="one line an event instead of the live view")
    run.set_defaults(run=_run)

    replay = commands.add_parser("replay", help="what the service would have done about a recording")
    replay.add_argument("recording", type=Path, metavar="FILE", help="a .tlog, or a flight's folder or .mcap")
    replay.add_argument("--config", type=Path, metavar="FILE", help="the profile (default: the built-in one)")
    replay.add_argument("--mission", type=Path, metavar="FILE.waypoints", help="where the stream has none")
    replay.add_argument("--parameters", type=Path, metavar="FILE.toml", help="those a pilot had set")
    replay.add_argument(
        "--pace", type=float, default=0.0, metavar="N", help="1: as recorded; 0: as fast as it goes"
    )
    replay.add_argument("--json", action="store_true", help="an array of objects instead of a table")
    replay.set_defaults(run=_replay)

    buttons = commands.add_parser("buttons", help="write QGroundControl's buttons for the vine")
    buttons.add_argument(
        "--config", type=Path, metavar="FILE", help="the profile (default: the built-in one)"
    )
    file = Path("FlyingVines.json")
    buttons.add_argument("--out", type=Path, default=file, metavar="FILE.json", help=f"where to ({file})")
    buttons.set_defaults(run=_buttons)

    config = commands.add_parser("config", help="write or check a profile")
    actions = config.add_subparsers(required=True, metavar="ACTION")
    init = actions.add_parser("init", help="write a commented profile")
    profile = Path("flying-vines.toml")
    init.add_argument(
        "file", type=Path, nargs="?", default=profile, metavar="FILE", help=f"where to ({profile})"
    )
    init.add_argument("--force", action="store_true", help="over a file that is there")
    init.set_defaults(run=_config_init)
    check = actions.add_parser("check", help="say exactly what is wrong with a profile")
    check.add_argument("file", type=Path, metavar="FILE", help="the profile")
    check.set_defaults(run=_config_check)

    paper = commands.add_parser("paper", help="reproduce the phloSAR paper: its every number beside ours")
    paper.add_argument("--out", type=Path, metavar="DIR", help="draw the figures there")
    paper.add_argument("--diagnose", action="store_true", help="why its measurements depart from its model")
    paper.add_argument("--json", action="store_true", help="one object instead of a table")
    paper.set_defaults(run=_paper)

    simulate = commands.add_parser("simulate", help="the simulated rig through a scenario, as recorded runs")
    simulate.add_argument("--rig", type=Path, required=True, metavar="RIG.toml", help="what is there")
    simulate.add_argument("--scenario", required=True, metavar="FILE", help="or an example: case, discharge")
    simulate.add_argument("--out", type=Path, required=True, metavar="DIR", help="the case folder")
    simulate.add_argument(
        "--seed", type=int, default=1, metavar="N", help="of the noise and what is drawn at random (1)"
    )
    simulate.set_defaults(run=_simulate)

    diagnose = commands.add_parser("diagnose", help="what the simulation gets wrong about a recorded rig")
    diagnose.add_argument(
        "case",
        type=Path,
        nargs="*",
        metavar="CASE",
        help="a folder with rig.toml and runs, a run, or a flight",
    )
    diagnose.add_argument("--from-log", type=Path, metavar="LOG", help="a flight log, or a flight's folder")
    diagnose.add_argument(
        "--rig", type=Path, metavar="RIG.toml", help="what is believed (default: what the case says)"
    )
    diagnose.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster that diagnoses the cases")
    diagnose.add_argument("--write-rig", type=Path, metavar="FILE", help="the rig with the cause in it")
    diagnose.add_argument("--plan", action="store_true", help="CASE is a rig.toml: which runs to record")
    diagnose.add_argument("--minutes", type=float, metavar="M", help="of recording, for a plan (3)")
    diagnose.add_argument(
        "--air-SL",
        type=float,
        metavar="N",
        dest="air_SL",
        help="standard litres, for a plan (a filling of the bottle)",
    )
    diagnose.add_argument(
        "--most-kPa", type=float, metavar="P", dest="most_kPa", help="gauge, to which a plan inflates (20.7)"
    )
    diagnose.add_argument("--out", type=Path, metavar="DIR", help="write a report there, or a plan's files")
    diagnose.add_argument("--json", action="store_true", help="one object instead of words")
    diagnose.set_defaults(run=_diagnose)

    design = commands.add_parser("design", help="which phloSAR a robot needs: the paper's design guide")
    design.add_argument("--robot", type=Path, metavar="FILE", help="its profile (default: the paper's vine)")
    design.add_argument(
        "--parts",
        type=Path,
        metavar="DIR",
        nargs="+",
        action="extend",
        default=[],
        help="parts beside the catalogue's",
    )
    design.add_argument("--out", type=Path, metavar="DIR", help="draw the figures there")
    design.add_argument("--json", action="store_true", help="one object instead of tables")
    design.set_defaults(run=_design)

    vine = commands.add_parser("vine", help="how far a pressure bends a vine, and what limits it")
    vine.add_argument(
        "--vine",
        metavar="FILE",
        nargs="+",
        action="extend",
        help="or an example: pouch, cpam, fpam (default: all three)",
    )
    vine.add_argument("--out", type=Path, metavar="DIR", help="draw the figures there")
    vine.add_argument("--json", action="store_true", help="one object instead of tables")
    vine.set_defaults(run=_vine)
    fit = vine.add_subparsers(metavar="ACTION").add_parser("fit", help="a bend curve out of measured pairs")
    fit.add_argument("pairs", type=Path, metavar="PAIRS.csv", help="pressure_kPa, angle_deg, up and down")
    fit.add_argument(
        "--out", type=Path, metavar="DIR", default=argparse.SUPPRESS, help="draw the figure there"
    )
    fit.add_argument("--json", action="store_true", default=argparse.SUPPRESS, help="one object instead")
    fit.set_defaults(run=_vine_fit)

    doctor_command.add(commands, FLIGHTS)
    calibrate_command.add(commands, FLIGHTS)

    mission_command.add(commands)
    log_command.add(commands)
    watch_command.add(commands)
    install_command.add(commands)

    link = commands.add_parser("link", help="what goes over the phloSAR's line, and its settings")
    link.add_argument("address", nargs="?", metavar="ADDRESS", help=f"(default: the profile's) {FORMS}")
    link.add_argument("--config", type=Path, metavar="FILE", help="the profile (default: the built-in one)")
    link.add_argument("--seconds", type=float, metavar="N", help="then end; with status 1 if nobody answered")
    link.add_argument("--json", action="store_true", help="one object a line")
    link.add_argument("--raw", action="store_true", help="the bytes as well")
    link.add_argument("--settings", action="store_true", help="what is set in the firmware")
    link.add_argument(
        "--set",
        action="append",
        default=[],
        dest="changes",
        metavar="NAME=VALUE",
        help="keep it in the firmware; may be given again",
    )
    link.set_defaults(run=_link)

    fake = commands.add_parser("fake", help="one end of the link, alone")
    fakes = fake.add_subparsers(required=True, metavar="WHAT")
    autopilot = fakes.add_parser("autopilot", help="a fake autopilot on UDP")
    autopilot.add_argument(
        "--kind", choices=("ardupilot", "px4"), default="ardupilot", help="whose habits it has (ardupilot)"
    )
    companion = "127.0.0.1:14540"
    autopilot.add_argument(
        "--to", default=companion, metavar="HOST:PORT", help=f"the companion ({companion})"
    )
    autopilot.add_argument("--gcs", metavar="HOST:PORT", help="a ground station as well")
    autopilot.add_argument("--mission", type=Path, metavar="FILE.waypoints", help="what it holds")
    autopilot.add_argument("--fly", action="store_true", help="take off at once, or fly the mission")
    autopilot.add_argument(
        "--listen",
        action="append",
        default=[],
        metavar="tcpin:HOST:PORT",
        help="clients may connect there; may be given again",
    )
    autopilot.set_defaults(run=_fake_autopilot)
    phlosar = fakes.add_parser("phlosar", help="a fake phloSAR on a pseudo-terminal; prints its path")
    phlosar.add_argument("--link", type=Path, metavar="PATH", help="a stable name for the port")
    phlosar.add_argument(
        "--reservoir-kPa",
        type=float,
        default=690.0,
        dest="reservoir_kPa",
        metavar="P",
        help="in the bottle, gauge (690)",
    )
    phlosar.add_argument(
        "--rig", type=Path, metavar="RIG.toml", help="what is there (default: a likely vine)"
    )
    phlosar.add_argument(
        "--telemetry-Hz",
        type=int,
        default=100,
        dest="telemetry_Hz",
        metavar="N",
        help="1000 for a diagnosis (100)",
    )
    phlosar.set_defaults(run=_fake_phlosar)
    return parser


def _demo(arguments: argparse.Namespace) -> int:
    from rich.console import Console

    from flying_vines.demo import fly, summary
    from flying_vines.pneumatics.plant.true_rig import load_true_rig
    from flying_vines.pneumatics.rig import RigError

    console = Console()
    live = console.is_terminal and not arguments.plain
    with _files(arguments.out, RigError):
        rig = load_true_rig(arguments.rig) if arguments.rig else None
        flight = asyncio.run(fly(arguments.out, console, live, rig, arguments.page))
    console.print(summary(flight))
    for surprise in flight.unasked:
        console.print(f"Not asked for: {surprise}", style="bold red")
    seen = ", ".join(f"{name} {value:.1f}" for name, value in sorted(flight.values.items()))
    console.print(f"\nThe ground station's last values: {seen}", highlight=False)
    console.print(f"Log      {flight.folder}", highlight=False, soft_wrap=True)
    if flight.picture:
        console.print(f"Picture  {flight.picture}", highlight=False, soft_wrap=True)
    console.print("Everything went as it should." if flight.passed else "The flight FAILED.", style="bold")
    return 0 if flight.passed else 1


def _run(arguments: argparse.Namespace) -> int:
    text = configuration.text_of(arguments.config)
    config = configuration.parse(text, str(arguments.config))
    return asyncio.run(_serve(config, text, _known(config, arguments.config, arguments.rig), arguments))


def _known(config: Config, profile: Path | None, rig: Path | None = None) -> Calibration | None:
    """What the rig file says that is given, or that the profile names; paths in it start from where it is."""
    rig = rig or configuration.rig_named(config, profile)
    if rig is None:
        return None
    from flying_vines.pneumatics.rig import RigError
    from flying_vines.reservoir.calibration import load_calibration

    with _files(rig, RigError):
        return load_calibration(rig, config.pneumatics)


async def _serve(config: Config, text: str, known: Calibration | None, arguments: argparse.Namespace) -> int:
    from rich.live import Live
    from rich.text import Text

    from flying_vines.gateway.gateway import Gateway
    from flying_vines.gateway.page_token import PageTokenError
    from flying_vines.kept import Kept
    from flying_vines.notice import Severity
    from flying_vines.notify import service_manager
    from flying_vines.record.recorder import Began, Recorder
    from flying_vines.service import Service
    from flying_vines.terminal import LiveView, PatientOutput, plain_printer
    from flying_vines.vehicle.parameter_file import ParameterFileError
    from flying_vines.vehicle.signing_key import SigningKeyError
    from flying_vines.watcher import EachAction

    kept = Kept.of(arguments.config, config)
    with _files(arguments.config, ParameterFileError, SigningKeyError, PageTokenError):
        parameters = kept.read_parameters(config)
        disarmed = kept.disarmed
        signing, clock_problem = kept.read_signing(config)
        page_token = kept.read_page_token(config)
    try:
        numbers = known.belief.pneumatics if known else config.pneumatics
        rig = known.path.read_text(encoding="utf-8") if known else ""
        began = Began(text, numbers, rig, parameters, disarmed)
        log = Recorder(arguments.out, began, config.log.least_free_MB)
    except OSError as error:
        _fail(f"{arguments.out}: no flight log can be written there: {error.strerror}")
    output = PatientOutput()
    console = output.console()
    loop = asyncio.get_running_loop()
    view = LiveView(loop.time(), config.limits.max_kPa, config.pneumatics.full_kPa)
    live = console.is_terminal and not arguments.plain
    shown = EachAction(view.take if live else plain_printer(console, loop.time()))
    belief = known.belief if known else None
    gateway = Gateway(
        config,
        ask=lambda *asked: service.ask(*asked),
        say=lambda text: service.say(Severity.WARNING, text),
        page_token=page_token,
    )
    watchers = (log, shown, gateway, *service_manager())
    service = Service(config, watchers, belief, parameters, disarmed, signing, kept)
    # What was imported lives as long as we do; the collector need not walk it in flight.
    gc.collect()
    gc.freeze()
    for name in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        loop.add_signal_handler(name, service.stop)
    links = f"Vehicle {config.vehicle.link}, phloSAR {config.firmware.link}"
    console.print(f"{links}, log {log.folder}", soft_wrap=True)
    console.print(f"Vehicle link {config.vehicle.believed}", highlight=False, soft_wrap=True)
    if known:
        console.print(f"Rig {known.path}: {known.said}", highlight=False, soft_wrap=True)
    for parameter, value in parameters.items():
        console.print(f"Parameter {parameter} = {value:g}", highlight=False)
    if clock_problem:
        console.print(clock_problem, highlight=False, soft_wrap=True)
    if config.page.port:
        said = _page_said(config, kept, page_token, console)
        view.say(Text(said))
        console.print(said, highlight=False, soft_wrap=True)
    serving = asyncio.create_task(service.run())
    tending = asyncio.create_task(gateway.run()) if Gateway.wanted(config) else None
    screen = Live(console=console, refresh_per_second=5, screen=True) if live else None
    problems: dict[str, str] = {}
    log_told = ""
    if screen:
        screen.start()
    try:
        while not serving.done():
            snapshot = service.core.snapshot(service.now)
            if log_told != log.told:
                log_told = log.told
                service.say(Severity.WARNING, log_told)
            if screen:
                try:
                    screen.update(view.render(snapshot, problems=service.link_problems))
                except Exception as error:
                    service.failed("screen", error)
                    screen.stop()
                    screen = None
            elif problems != service.link_problems:
                problems = dict(service.link_problems)
                for link, why in problems.items():
                    console.print(f"{link} link: {why or 'open'}", soft_wrap=True)
            await asyncio.wait([serving], timeout=SNAPSHOT_S)
        await serving
    finally:
        if screen:
            screen.stop()
        if tending:
            tending.cancel()
            await asyncio.wait([tending])
        log.close()
    if log.failed:
        console.print(log.failed)
    console.print("Vented. Stopped.")
    output.close()
    return 0


def _page_said(config: Config, kept: Kept, page_token: str, console: Console) -> str:
    """Where the page is. Its token is for those at the terminal, not for a log that others read."""
    from flying_vines.gateway.page_token import address, watching

    if page_token and not console.is_terminal:
        return f"Page {address(config.page)}, token in {kept.page_token}"
    if page_token:
        only_watches = f"; to watch only: token {watching(page_token)}"
        return f"Page {address(config.page, page_token)}{only_watches}"
    return f"Page {address(config.page)}"


def _link(arguments: argparse.Namespace) -> int:
    from flying_vines.link_command import SettingsError, monitor, settings

    title: str | None = arguments.address
    if title is None:
        config = configuration.load(arguments.config) if arguments.config else configuration.default()
        title = config.firmware.link
    if arguments.seconds is not None and not arguments.seconds > 0.0:
        _fail("--seconds must be above 0")
    try:
        address = parse_address(title)
        changes = dict(map(_change, arguments.changes))
        if arguments.settings or changes:
            asyncio.run(settings(address, changes, arguments.json))
            return 0
    except (ValueError, SettingsError) as error:
        _fail(str(error))
    answered = asyncio.run(monitor(address, title, arguments.seconds, arguments.json, arguments.raw))
    return 0 if answered else 1


def _change(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        return name, float(value)
    except ValueError:
        raise ValueError(f"--set {text}: give NAME=VALUE, with a number") from None


def _buttons(arguments: argparse.Namespace) -> int:
    from flying_vines.buttons import write_buttons

    config = configuration.load(arguments.config) if arguments.config else configuration.default()
    with _files(arguments.out):
        write_buttons(config, arguments.out)
    print(f"{arguments.out}: for QGroundControl's folder MavlinkActions; choose it in the Fly View settings")
    return 0


def _replay(arguments: argparse.Namespace) -> int:
    from flying_vines.events import Decision
    from flying_vines.replay import as_json, replay
    from flying_vines.vehicle.parameter_file import ParameterFileError
    from flying_vines.vehicle.parameter_file import read as read_parameters
    from flying_vines.vehicle.tlog import TlogError, TlogReader

    recording: Path = arguments.recording
    if recording.is_dir() or recording.suffix == ".mcap":
        if arguments.mission or arguments.parameters or arguments.pace:
            _fail("--mission, --parameters and --pace are for a .tlog: a flight's log holds all of its own")
        return log_command.replay_again(recording, arguments.config, arguments.json)
    config = configuration.load(arguments.config) if arguments.config else configuration.default()
    known = _known(config, arguments.config)
    mission = _mission(arguments.mission)
    if not arguments.pace >= 0.0:
        _fail("--pace must not be below 0")
    parameters: dict[str, float] = {}
    if arguments.parameters:
        with _files(arguments.parameters, ParameterFileError):
            parameters = read_parameters(arguments.parameters, config)
    try:
        reader = TlogReader(recording)
        belief = known.belief if known else None
        actions = replay(
            reader.frames(), config, mission, arguments.pace, belief=belief, parameters=parameters
        )
        show = _shower(live=arguments.pace > 0.0 and not arguments.json)
        decisions: list[Decision] = []
        for action in actions:
            show(action)
            if isinstance(action, Decision):
                decisions.append(action)
    except TlogError as error:
        _fail(str(error))
    if arguments.json:
        print(json.dumps([as_json(decision) for decision in decisions], indent=1))
    else:
        from rich.console import Console

        from flying_vines.terminal import decision_table

        Console().print(decision_table(decisions))
    if reader.skipped_bytes:
        print(
            f"flying-vines: {recording}: {reader.skipped_bytes} bytes of it are no MAVLink frame",
            file=sys.stderr,
        )
    return 0


def _shower(live: bool) -> Callable[[Action], None]:
    """Prints what happens as it happens, for those who replay at the recorded pace."""
    if not live:
        return lambda action: None
    from rich.console import Console

    from flying_vines.terminal import plain_printer

    return plain_printer(Console(), 0.0)


def _config_init(arguments: argparse.Namespace) -> int:
    path: Path = arguments.file
    try:
        with path.open("w" if arguments.force else "x", encoding="utf-8") as file:
            file.write(configuration.default_text())
    except FileExistsError:
        _fail(f"{path} is there already; --force writes over it")
    except OSError as error:
        _fail(f"{path}: cannot be written: {error.strerror}")
    print(f"Wrote {path}. Check it with: flying-vines config check {path}")
    return 0


def _config_check(arguments: argparse.Namespace) -> int:
    config = configuration.load(arguments.file)
    known = _known(config, arguments.file)
    print(
        f"{arguments.file}: good. Switch on channel {config.switch.channel}, {len(config.profiles)} "
        f"profiles, {len(config.items)} item rules, up to {config.limits.max_kPa:g} kPa."
    )
    print(f"Vehicle link {config.vehicle.believed}.")
    if known:
        print(f"{known.path}: good. {known.said[0].upper()}{known.said[1:]}.")
    return 0


def _diagnose(arguments: argparse.Namespace) -> int:
    if arguments.plan:
        return _plan(arguments)
    for option in _OF_A_PLAN:
        if getattr(arguments, option) is not None:
            _fail(f"--{option.replace('_', '-')} belongs to --plan")
    if len(arguments.case) + (arguments.from_log is not None) != 1 or arguments.scheduler:
        return _diagnose_all(arguments)
    with _analysis():
        from flying_vines.discrepancy.case import CaseError
        from flying_vines.discrepancy.diagnose import diagnose
        from flying_vines.discrepancy.extended import extended_rig
        from flying_vines.discrepancy.from_log import read_flight
        from flying_vines.discrepancy.many import read_any
        from flying_vines.discrepancy.show import show
        from flying_vines.pneumatics.plant.true_rig import true_rig_text
        from flying_vines.pneumatics.rig import RigError

        if arguments.out:
            from flying_vines.discrepancy.report import write_report
    from rich.console import Console

    with _files(arguments.write_rig, CaseError, RigError):
        if arguments.from_log:
            case = read_flight(arguments.from_log, arguments.rig)
        else:
            case = read_any(arguments.case[0], arguments.rig)
        if arguments.out:
            # Not only after all the work is it said that there can be no report.
            arguments.out.mkdir(parents=True, exist_ok=True)
        with _analysis(), _progress() as progress:
            verdict = diagnose(case, progress=progress)
        if arguments.write_rig:
            arguments.write_rig.write_text(true_rig_text(extended_rig(case.rig, verdict)), encoding="utf-8")
        files = write_report(verdict, case, arguments.out) if arguments.out else []
    if arguments.json:
        print(json.dumps(verdict.as_json(), allow_nan=False))
        return 0
    console = Console()
    show(verdict, console)
    if files:
        console.print(f"Report   {files[0]}", highlight=False, soft_wrap=True)
    return 0


_OF_A_PLAN = ("minutes", "air_SL", "most_kPa")


def _plan(arguments: argparse.Namespace) -> int:
    for option in ("from_log", "rig", "scheduler", "write_rig"):
        if getattr(arguments, option) is not None:
            _fail(f"--{option.replace('_', '-')} does not go with --plan")
    if len(arguments.case) != 1:
        _fail("--plan needs one CASE, the rig.toml of the believed rig")
    with _analysis():
        from flying_vines.discrepancy.plan import PlanError, plan
        from flying_vines.discrepancy.plan.picture import figures
        from flying_vines.discrepancy.plan.show import show
        from flying_vines.discrepancy.plan.write import write_plan
        from flying_vines.pneumatics.rig import RigError, load_rig
        from flying_vines.record.style import save

    folder: Path | None = arguments.out
    limits = {name: getattr(arguments, name) for name in _OF_A_PLAN}
    with _files(folder, PlanError, RigError):
        rig = load_rig(arguments.case[0])
        with _analysis(), _progress() as progress:
            found = plan(rig, **{k: v for k, v in limits.items() if v is not None}, progress=progress)
        files = write_plan(found, folder) if folder else []
        drawn = save(figures(found), folder, "plan") if folder else []

    def shown(console: Console) -> None:
        show(found, console)
        for path in files:
            console.print(f"Written  {path}", highlight=False, soft_wrap=True)

    written = {"files": [str(path) for path in files]}
    return _show_found(arguments.json, lambda: {**found.as_json(), **written}, shown, drawn)


def _diagnose_all(arguments: argparse.Namespace) -> int:
    for option in ("from_log", "write_rig", "out"):
        if getattr(arguments, option) is not None:
            _fail(f"--{option.replace('_', '-')} is for one case, on this machine")
    if not arguments.case:
        _fail("diagnose needs a CASE, or a flight log: --from-log LOG")
    with _analysis():
        from flying_vines.discrepancy.many import ClusterError, diagnose_all
        from flying_vines.discrepancy.show_many import show_all
    from rich.console import Console

    outcomes = diagnose_all(arguments.case, scheduler=arguments.scheduler, rig=arguments.rig)
    with _files(arguments.case[0], ClusterError):
        every = show_all(outcomes, len(arguments.case), arguments.json, Console())
    return 0 if every else BAD_INPUT


def _paper(arguments: argparse.Namespace) -> int:
    folder: Path | None = arguments.out
    if arguments.diagnose:
        return _paper_diagnosis(folder, arguments.json)
    with _analysis():
        from flying_vines.paper import as_json, compare

        if folder:
            from flying_vines.paper.figures import draw
    from flying_vines.paper.show import show

    with _analysis(), _files(folder):
        if folder:
            folder.mkdir(parents=True, exist_ok=True)
        comparison = compare()
        figures = draw(comparison.curves, folder) if folder else []
    return _show_found(
        arguments.json,
        lambda: as_json(comparison),
        lambda console: show(comparison.rows, comparison.findings, console),
        figures,
    )


def _paper_diagnosis(folder: Path | None, json_wanted: bool) -> int:
    from rich.console import Console

    with _analysis():
        from flying_vines.paper.diagnosis import diagnose_paper
        from flying_vines.paper.diagnosis.show import show
        from flying_vines.paper.diagnosis.verdict import as_json

        if folder:
            from flying_vines.paper.diagnosis.figures import draw
    with _analysis(), _files(folder):
        if folder:
            folder.mkdir(parents=True, exist_ok=True)
        with Console(stderr=True).status("reading") as status:
            diagnosis = diagnose_paper(status.update)
        figures = draw(diagnosis, folder) if folder else []
    return _show_found(
        json_wanted, lambda: as_json(diagnosis), lambda console: show(diagnosis, console), figures
    )


def _simulate(arguments: argparse.Namespace) -> int:
    from flying_vines.pneumatics.plant.true_rig import TrueRig, load_true_rig, true_rig_text
    from flying_vines.pneumatics.rig import RigError, load_rig

    folder: Path = arguments.out
    with _analysis():
        from flying_vines.simulate import (
            CaseError,
            ScenarioError,
            load_scenario,
            simulate_scenario,
            write_case,
        )
        from flying_vines.simulate.picture import draw_runs
    with _files(folder, RigError, ScenarioError, CaseError):
        rig = load_true_rig(arguments.rig)
        scenario = load_scenario(arguments.scenario)
        began_s = monotonic()
        try:
            runs = simulate_scenario(rig, scenario, arguments.seed)
        except ScenarioError as error:
            _fail(f"{arguments.scenario}: {error}")
        took_s = monotonic() - began_s
        given = arguments.rig.read_bytes()
        try:
            load_rig(arguments.rig)
            paths = write_case(runs, given, folder)
        except RigError:
            paths = write_case(runs, true_rig_text(TrueRig(rig.believed)).encode(), folder, given)
        picture = folder / "picture.png"
        draw_runs(runs, picture, scenario.name or str(arguments.scenario))
    for path, run in zip(paths, runs, strict=True):
        print(f"Run      {path}" + (f"  the firmware vented: {run.faults}" if run.faults else ""))
    print(f"Picture  {picture}")
    simulated_s = sum(run.length_s for run in scenario.runs)
    print(
        f"{simulated_s:.0f} s of the rig, simulated at {simulated_s / max(took_s, 1e-9):.0f} times real time."
    )
    return 0


def _design(arguments: argparse.Namespace) -> int:
    folder: Path | None = arguments.out
    with _analysis():
        from flying_vines.design import catalogue, evaluate
        from flying_vines.design import robot as profile
        from flying_vines.design.compass import compass
        from flying_vines.design.search import Performance, evaluate_all, front
        from flying_vines.design.show import as_json, show

        if folder:
            from flying_vines.design.figures import draw
    robot = profile.load(arguments.robot) if arguments.robot else profile.demonstration()
    parts = catalogue(*arguments.parts)
    evaluation = evaluate(robot, parts.choose(robot.parts, str(arguments.robot or "vine.toml")))
    tried = evaluate_all(robot, parts)
    performances: tuple[Performance, ...] = ("cycles", "inflation", "deflation")
    fronts = {by: front(tried, by) for by in performances}
    compared = compass(evaluation, evaluate(robot, parts.choose()))
    figures: Sequence[Path] = ()
    with _files(folder):
        if folder:
            folder.mkdir(parents=True, exist_ok=True)
            figures = draw(evaluation, tried, compared, folder)
    return _show_found(
        arguments.json,
        lambda: as_json(evaluation, fronts, compared),
        lambda console: show(evaluation, fronts, compared, tried, console),
        figures,
    )


def _vine(arguments: argparse.Namespace) -> int:
    folder: Path | None = arguments.out
    with _analysis():
        from flying_vines.vine.bending import VineError, bend, examples, load_vine
        from flying_vines.vine.bending.show import as_json, show

        if folder:
            from flying_vines.vine.bending.figures import draw
    figures: Sequence[Path] = ()
    with _files(folder, VineError):
        found = [bend(load_vine(source)) for source in arguments.vine or examples()]
        if folder:
            folder.mkdir(parents=True, exist_ok=True)
            figures = draw(found, folder)

    def show_all(console: Console) -> None:
        for i, b in enumerate(found):
            if i:
                console.print()
            show(b, console)

    return _show_found(arguments.json, lambda: {"vines": [as_json(b) for b in found]}, show_all, figures)


def _vine_fit(arguments: argparse.Namespace) -> int:
    folder: Path | None = arguments.out
    with _analysis():
        from flying_vines.vine.calibration import PairsError, fit, load_pairs
        from flying_vines.vine.calibration.show import as_json, show

        if folder:
            from flying_vines.vine.calibration.figures import draw
    figures: Sequence[Path] = ()
    with _files(folder, PairsError):
        found = fit(load_pairs(arguments.pairs))
        if folder:
            folder.mkdir(parents=True, exist_ok=True)
            figures = draw(found, folder, f"{arguments.pairs.name}: bend against pressure")
    return _show_found(arguments.json, lambda: as_json(found), lambda console: show(found, console), figures)


def _fake_autopilot(arguments: argparse.Namespace) -> int:
    from flying_vines.fakes.autopilot import Autopilot
    from flying_vines.fakes.autopilot_server import AutopilotServer
    from flying_vines.fakes.console import HELP, obey, type_to

    mission = _mission(arguments.mission)
    script: list[tuple[float, Callable[[Autopilot], None]]] = []
    if arguments.fly:
        fly = Autopilot.start_mission if mission else lambda autopilot: autopilot.takeoff(10.0)
        script.append((3.0, fly))
    try:
        autopilot = Autopilot(arguments.kind, mission=mission, unix_s=time())
        gcs = f"udpout:{arguments.gcs}" if arguments.gcs else None
        server = AutopilotServer(autopilot, f"udpout:{arguments.to}", gcs, script, listen=arguments.listen)
    except ValueError as error:
        _fail(str(error))

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
        _fail(f"{' '.join(arguments.listen)}: {getattr(taken, 'strerror', None) or taken}")
    return 0


def _fake_phlosar(arguments: argparse.Namespace) -> int:
    from flying_vines.fakes.board import best_board, why_emulated
    from flying_vines.fakes.console import MISHAPS, suffer, type_to
    from flying_vines.fakes.firmware import FirmwareSettings
    from flying_vines.fakes.phlosar import PtyPhlosar, SimulatedPhlosar
    from flying_vines.pneumatics.plant.true_rig import load_true_rig
    from flying_vines.pneumatics.rig import RigError

    if not 10 <= arguments.telemetry_Hz <= 1000:
        _fail("--telemetry-Hz is from 10 to 1000")
    if why := why_emulated():
        print(f"The firmware is emulated: {why}.", file=sys.stderr, flush=True)
    try:
        rig = load_true_rig(arguments.rig) if arguments.rig else None
        board = best_board(FirmwareSettings(telemetry_Hz=arguments.telemetry_Hz))
        phlosar = SimulatedPhlosar(rig, board, reservoir_kPa=arguments.reservoir_kPa)
        with PtyPhlosar(phlosar, arguments.link) as port:

            async def live() -> None:
                print(port.path, flush=True)
                if sys.stdin.isatty():
                    print("Type to break it, as `hose off` or `evp stuck 1`; Ctrl-C ends it.")
                    print(MISHAPS, flush=True)
                await asyncio.gather(port.run(), type_to(lambda line: suffer(phlosar, line)))

            asyncio.run(live())
    except RigError as error:
        _fail(str(error))
    except OSError as error:
        _fail(f"{arguments.link}: {error.strerror or error}")
    return 0


def _mission(path: Path | None) -> Sequence[MissionItem]:
    if path is None:
        return ()
    from missions.waypoints import WaypointsError, read_waypoints

    try:
        return read_waypoints(path)
    except WaypointsError as error:
        _fail(str(error))
    except OSError as error:
        _fail(f"{path}: {error.strerror}")
