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
from time import monotonic
from typing import TYPE_CHECKING, Any, NoReturn

from flying_vines import config as configuration
from flying_vines.config import Config, ConfigError
from flying_vines.vehicle.mission_item import MissionItem

if TYPE_CHECKING:
    from rich.console import Console

    from flying_vines.events import Action

BAD_INPUT = 2
FLIGHTS = Path("flights")
SNAPSHOT_S = 0.05


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """The `flying-vines` command. Exit status 2 and one line on standard error for bad input."""
    arguments = _parser().parse_args(argv)
    try:
        status = arguments.run(arguments)
    except ConfigError as error:
        _fail(str(error))
    except KeyboardInterrupt:
        status = 130
    except BrokenPipeError:
        # Whoever read our output has seen enough; Python's own flush at exit must not complain.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = 0
    sys.exit(status)


def _fail(sentence: str) -> NoReturn:
    print(f"flying-vines: {sentence}", file=sys.stderr)
    sys.exit(BAD_INPUT)


@contextmanager
def _analysis() -> Iterator[None]:
    """What follows needs the extra: one line says so where it is not installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        _fail(f"{error.name} is missing; pip install 'flying-vines[analysis]' brings it")
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


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="flying-vines", description="A soft robot arm on a drone.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    demo = commands.add_parser("demo", help="fly a scripted flight on embedded fakes")
    demo.add_argument("--out", type=Path, default=FLIGHTS, help="where the flight's folder goes (flights)")
    demo.add_argument("--plain", action="store_true", help="one line an event instead of the live view")
    demo.add_argument("--rig", type=Path, metavar="RIG.toml", help="what is there (default: a likely vine)")
    demo.set_defaults(run=_demo)

    run = commands.add_parser("run", help="serve a vehicle and a phloSAR")
    run.add_argument("--config", type=Path, required=True, metavar="FILE", help="the profile")
    run.add_argument("--out", type=Path, default=FLIGHTS, help="where the flight log goes (flights)")
    run.add_argument("--plain", action="store_true", help="one line an event instead of the live view")
    run.set_defaults(run=_run)

    replay = commands.add_parser("replay", help="what the service would have done about a recording")
    replay.add_argument("tlog", type=Path, metavar="FILE.tlog")
    replay.add_argument("--config", type=Path, metavar="FILE", help="the profile (default: the built-in one)")
    replay.add_argument("--mission", type=Path, metavar="FILE.waypoints", help="where the stream has none")
    replay.add_argument("--pace", type=float, default=0.0, help="1: as recorded; 0: as fast as it goes")
    replay.add_argument("--json", action="store_true", help="an array of objects instead of a table")
    replay.set_defaults(run=_replay)

    config = commands.add_parser("config", help="write or check a profile")
    actions = config.add_subparsers(required=True, metavar="ACTION")
    init = actions.add_parser("init", help="write a commented profile")
    init.add_argument("file", type=Path, nargs="?", default=Path("flying-vines.toml"))
    init.add_argument("--force", action="store_true", help="over a file that is there")
    init.set_defaults(run=_config_init)
    check = actions.add_parser("check", help="say exactly what is wrong with a profile")
    check.add_argument("file", type=Path)
    check.set_defaults(run=_config_check)

    paper = commands.add_parser("paper", help="reproduce the phloSAR paper: its every number beside ours")
    paper.add_argument("--out", type=Path, metavar="DIR", help="draw the figures there")
    paper.add_argument("--json", action="store_true", help="one object instead of a table")
    paper.set_defaults(run=_paper)

    simulate = commands.add_parser("simulate", help="the simulated rig through a scenario, as recorded runs")
    simulate.add_argument("--rig", type=Path, required=True, metavar="RIG.toml")
    simulate.add_argument("--scenario", required=True, metavar="FILE", help="or an example: case, discharge")
    simulate.add_argument("--out", type=Path, required=True, metavar="DIR", help="the case folder")
    simulate.add_argument("--seed", type=int, default=1, help="of the noise and what is drawn at random (1)")
    simulate.set_defaults(run=_simulate)

    diagnose = commands.add_parser("diagnose", help="what the simulation gets wrong about a recorded rig")
    diagnose.add_argument("case", type=Path, metavar="CASE", help="a folder with rig.toml and runs, or a run")
    diagnose.add_argument("--rig", type=Path, metavar="RIG.toml", help="(default: the folder's rig.toml)")
    diagnose.add_argument("--write-rig", type=Path, metavar="FILE", help="the rig with the cause in it")
    diagnose.add_argument("--json", action="store_true", help="one object instead of words")
    diagnose.set_defaults(run=_diagnose)

    design = commands.add_parser("design", help="which phloSAR a robot needs: the paper's design guide")
    design.add_argument("--robot", type=Path, metavar="FILE", help="its profile (default: the paper's vine)")
    design.add_argument("--parts", type=Path, metavar="DIR", nargs="+", action="extend", default=[])
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

    fake = commands.add_parser("fake", help="one end of the link, alone")
    fakes = fake.add_subparsers(required=True, metavar="WHAT")
    autopilot = fakes.add_parser("autopilot", help="a fake autopilot on UDP")
    autopilot.add_argument("--kind", choices=("ardupilot", "px4"), default="ardupilot")
    autopilot.add_argument("--to", default="127.0.0.1:14540", metavar="HOST:PORT", help="the companion")
    autopilot.add_argument("--gcs", metavar="HOST:PORT", help="a ground station as well")
    autopilot.add_argument("--mission", type=Path, metavar="FILE.waypoints")
    autopilot.add_argument("--fly", action="store_true", help="take off at once, or fly the mission")
    autopilot.set_defaults(run=_fake_autopilot)
    phlosar = fakes.add_parser("phlosar", help="a fake phloSAR on a pseudo-terminal; prints its path")
    phlosar.add_argument("--link", type=Path, metavar="PATH", help="a stable name for the port")
    phlosar.add_argument("--reservoir-kPa", type=float, default=690.0, dest="reservoir_kPa")
    phlosar.add_argument(
        "--rig", type=Path, metavar="RIG.toml", help="what is there (default: a likely vine)"
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
        flight = asyncio.run(fly(arguments.out, console, live, rig))
    console.print(summary(flight))
    for surprise in flight.unasked:
        console.print(f"Not asked for: {surprise}", style="bold red")
    seen = ", ".join(f"{name} {value:.1f}" for name, value in sorted(flight.values.items()))
    console.print(f"\nThe ground station's last values: {seen}", highlight=False)
    console.print(f"Log      {flight.folder / 'flight.jsonl'}", highlight=False, soft_wrap=True)
    if flight.picture:
        console.print(f"Picture  {flight.picture}", highlight=False, soft_wrap=True)
    console.print("Everything went as it should." if flight.passed else "The flight FAILED.", style="bold")
    return 0 if flight.passed else 1


def _run(arguments: argparse.Namespace) -> int:
    config = configuration.load(arguments.config)
    return asyncio.run(_serve(config, arguments))


async def _serve(config: Config, arguments: argparse.Namespace) -> int:
    from rich.console import Console
    from rich.live import Live

    from flying_vines.record.flight_log import FlightLog
    from flying_vines.service import Service
    from flying_vines.terminal import LiveView, plain_printer

    try:
        log = FlightLog(arguments.out)
    except OSError as error:
        _fail(f"{arguments.out}: no flight log can be written there: {error.strerror}")
    console = Console()
    loop = asyncio.get_running_loop()
    view = LiveView(loop.time(), config.limits.max_kPa, config.pneumatics.full_kPa)
    live = console.is_terminal and not arguments.plain
    show = view.take if live else plain_printer(console, loop.time())

    def on_action(action: Action) -> None:
        log.action(action)
        show(action)

    service = Service(config, on_action)
    # What was imported lives as long as we do; the collector need not walk it in flight.
    gc.collect()
    gc.freeze()
    for name in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(name, service.stop)
    console.print(f"Vehicle {config.vehicle.link}, phloSAR {config.firmware.link}, log {log.path}")
    serving = asyncio.create_task(service.run())
    screen = Live(console=console, refresh_per_second=5, screen=True) if live else None
    problems: dict[str, str] = {}
    if screen:
        screen.start()
    try:
        while not serving.done():
            snapshot = service.core.snapshot(service.now)
            log.snapshot(snapshot)
            if screen:
                screen.update(view.render(snapshot, problems=service.link_problems))
            elif problems != service.link_problems:
                problems = dict(service.link_problems)
                for link, why in problems.items():
                    console.print(f"{link} link: {why or 'open'}", soft_wrap=True)
            await asyncio.wait([serving], timeout=SNAPSHOT_S)
        await serving
    finally:
        if screen:
            screen.stop()
        log.close()
    if log.failed:
        console.print(log.failed)
    console.print("Vented. Stopped.")
    return 0


def _replay(arguments: argparse.Namespace) -> int:
    from flying_vines.events import Decision
    from flying_vines.replay import as_json, replay
    from flying_vines.vehicle.tlog import TlogError, TlogReader

    config = configuration.load(arguments.config) if arguments.config else configuration.default()
    mission = _mission(arguments.mission)
    if not arguments.pace >= 0.0:
        _fail("--pace must not be below 0")
    try:
        reader = TlogReader(arguments.tlog)
        actions = replay(reader.frames(), config, mission, arguments.pace)
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
            f"flying-vines: {arguments.tlog}: {reader.skipped_bytes} bytes of it are no MAVLink frame",
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
    print(
        f"{arguments.file}: good. Switch on channel {config.switch.channel}, {len(config.profiles)} "
        f"profiles, {len(config.items)} item rules, up to {config.limits.max_kPa:g} kPa."
    )
    return 0


def _diagnose(arguments: argparse.Namespace) -> int:
    with _analysis():
        from flying_vines.discrepancy.case import CaseError, read_case
        from flying_vines.discrepancy.diagnose import diagnose
        from flying_vines.discrepancy.extended import extended_rig
        from flying_vines.discrepancy.show import show
        from flying_vines.pneumatics.plant.true_rig import true_rig_text
        from flying_vines.pneumatics.rig import RigError
    from rich.console import Console

    with _files(arguments.write_rig, CaseError, RigError):
        case = read_case(arguments.case, arguments.rig)
        with _analysis(), Console(stderr=True).status("reading") as status:
            verdict = diagnose(case, progress=status.update)
        if arguments.write_rig:
            arguments.write_rig.write_text(true_rig_text(extended_rig(case.rig, verdict)), encoding="utf-8")
    if arguments.json:
        print(json.dumps(verdict.as_json(), allow_nan=False))
    else:
        show(verdict, Console())
    return 0


def _paper(arguments: argparse.Namespace) -> int:
    folder: Path | None = arguments.out
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
    from flying_vines.fakes.autopilot_udp import AutopilotServer
    from flying_vines.fakes.console import HELP, type_to

    mission = _mission(arguments.mission)
    script: list[tuple[float, Callable[[Autopilot], None]]] = []
    if arguments.fly:
        fly = Autopilot.start_mission if mission else lambda autopilot: autopilot.takeoff(10.0)
        script.append((3.0, fly))
    try:
        autopilot = Autopilot(arguments.kind, mission=mission)
        gcs = f"udpout:{arguments.gcs}" if arguments.gcs else None
        server = AutopilotServer(autopilot, f"udpout:{arguments.to}", gcs, script)
    except ValueError as error:
        _fail(str(error))
    print(f"A fake {arguments.kind} sends to {arguments.to}. Type to fly it; Ctrl-C ends it.", flush=True)
    print(HELP, flush=True)

    async def serve() -> None:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(server.run())
            tasks.create_task(type_to(autopilot))

    asyncio.run(serve())
    return 0


def _fake_phlosar(arguments: argparse.Namespace) -> int:
    from flying_vines.fakes.phlosar import PtyPhlosar, SimulatedPhlosar
    from flying_vines.pneumatics.plant.true_rig import load_true_rig
    from flying_vines.pneumatics.rig import RigError

    try:
        rig = load_true_rig(arguments.rig) if arguments.rig else None
        phlosar = SimulatedPhlosar(rig, reservoir_kPa=arguments.reservoir_kPa)
        with PtyPhlosar(phlosar, arguments.link) as port:
            print(arguments.link or port.path, flush=True)
            asyncio.run(port.run())
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
