"""Commands of the lab: `flying-vines simulate`, `paper`, `design` and `vine fit`.

They simulate a rig in a scenario, show every number of the paper beside ours, find the phloSAR that a robot
needs, and make a bend curve from measured pairs.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from time import monotonic
from typing import Any

from flying_vines.cli.common import add_option, fail, file_errors, needs_analysis, progress_bar, show_found

DRAWN = "draw the figures there"


def add_simulate(commands: Any) -> None:
    """Add `simulate` to the parsers of the command line."""
    simulate = commands.add_parser("simulate", help="simulate a rig in a scenario, and write recorded runs")
    add_option(simulate, "--rig", required=True, help="the simulated rig")
    simulate.add_argument(
        "--scenario", required=True, metavar="FILE", help="file, or an example: case, discharge"
    )
    add_option(simulate, "--out", required=True, help="the case folder")
    simulate.add_argument("--seed", type=int, default=1, metavar="N", help="seed of all random numbers (1)")
    add_option(simulate, "--cause")
    simulate.set_defaults(run=_simulate)


def _simulate(arguments: argparse.Namespace) -> int:
    from flying_vines.files.bounded import read_bytes
    from flying_vines.physics.plant.true_rig import TrueRig, load_true_rig, true_rig_text
    from flying_vines.physics.rig import RigError, load_rig

    folder: Path = arguments.out
    with needs_analysis():
        from flying_vines.simulation.scenario import (
            CaseFolderError,
            ScenarioError,
            load_scenario,
            simulate_scenario,
            write_case,
        )
        from flying_vines.simulation.scenario.picture import draw_runs
    with file_errors(folder, RigError, ScenarioError, CaseFolderError):
        rig = load_true_rig(arguments.rig)
        scenario = load_scenario(arguments.scenario)
        began_s = monotonic()
        try:
            runs = simulate_scenario(rig, scenario, arguments.seed)
        except ScenarioError as error:
            fail(f"{arguments.scenario}: {error}")
        took_s = monotonic() - began_s
        given = read_bytes(arguments.rig)
        try:
            load_rig(arguments.rig)
            paths = write_case(runs, given, folder)
        except RigError:
            paths = write_case(runs, true_rig_text(TrueRig(rig.nominal)).encode(), folder, given)
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


def add_paper(commands: Any) -> None:
    """Add `paper` to the parsers of the command line."""
    paper = commands.add_parser("paper", help="reproduce the phloSAR paper: all its numbers beside ours")
    add_option(paper, "--out", help=DRAWN)
    paper.add_argument(
        "--diagnose", action="store_true", help="find why the paper's measurements differ from its model"
    )
    add_option(paper, "--json")
    paper.set_defaults(run=_paper)


def _paper(arguments: argparse.Namespace) -> int:
    folder: Path | None = arguments.out
    if arguments.diagnose:
        return _paper_diagnosis(folder, arguments.json)
    with needs_analysis():
        from flying_vines.studies.paper import as_json, compare

        if folder:
            from flying_vines.studies.paper.figures import draw
    from flying_vines.studies.paper.report import show

    with needs_analysis(), file_errors(folder):
        if folder:
            folder.mkdir(parents=True, exist_ok=True)
        comparison = compare()
        figures = draw(comparison.curves, folder) if folder else []
    return show_found(
        arguments.json,
        lambda: as_json(comparison),
        lambda console: show(comparison.rows, comparison.findings, console),
        figures,
    )


def _paper_diagnosis(folder: Path | None, json_wanted: bool) -> int:
    with needs_analysis():
        from flying_vines.studies.paper.diagnosis import diagnose_paper
        from flying_vines.studies.paper.diagnosis.report import as_json, show

        if folder:
            from flying_vines.identification.report import write_report
            from flying_vines.studies.paper.figures import draw_diagnosis
    with needs_analysis(), file_errors(folder):
        if folder:
            folder.mkdir(parents=True, exist_ok=True)
        with progress_bar() as progress:
            diagnosis = diagnose_paper(progress)
        figures = draw_diagnosis(diagnosis, folder) if folder else []
        if folder:
            write_report(diagnosis.discharges.verdict, diagnosis.discharges.case, folder)
    return show_found(
        json_wanted, lambda: as_json(diagnosis), lambda console: show(diagnosis, console), figures
    )


def add_design(commands: Any) -> None:
    """Add `design` to the parsers of the command line."""
    design = commands.add_parser("design", help="find the phloSAR for a robot, by the paper's design guide")
    design.add_argument("--robot", type=Path, metavar="FILE", help="the robot (default: the paper's vine)")
    design.add_argument(
        "--parts",
        type=Path,
        metavar="DIR",
        nargs="+",
        action="extend",
        default=[],
        help="folders with parts, in addition to the catalogue",
    )
    add_option(design, "--out", help=DRAWN)
    add_option(design, "--json")
    design.set_defaults(run=_design)


def _design(arguments: argparse.Namespace) -> int:
    folder: Path | None = arguments.out
    with needs_analysis():
        from flying_vines.studies.design import catalogue, evaluate
        from flying_vines.studies.design import robot as requirements
        from flying_vines.studies.design.evaluate import Performance, evaluate_all, front
        from flying_vines.studies.design.show import as_json, show

        if folder:
            from flying_vines.studies.design.figures import draw
    robot = requirements.load(arguments.robot) if arguments.robot else requirements.demonstration()
    parts = catalogue(*arguments.parts)
    evaluation = evaluate(robot, parts.choose(robot.parts, str(arguments.robot or "vine.toml")))
    tried = evaluate_all(robot, parts)
    performances: tuple[Performance, ...] = ("cycles", "inflation", "deflation")
    fronts = {by: front(tried, by) for by in performances}
    figures: Sequence[Path] = ()
    with file_errors(folder):
        if folder:
            folder.mkdir(parents=True, exist_ok=True)
            figures = draw(evaluation, tried, folder)
    return show_found(
        arguments.json,
        lambda: as_json(evaluation, fronts),
        lambda console: show(evaluation, fronts, tried, console),
        figures,
    )


def add_vine(commands: Any) -> None:
    """Add `vine` to the parsers of the command line."""
    vine = commands.add_parser("vine", help="the bend curve of a vine")
    actions = vine.add_subparsers(metavar="ACTION", required=True)
    fit = actions.add_parser("fit", help="fit a bend curve to measured pairs")
    fit.add_argument(
        "pairs", type=Path, metavar="PAIRS.csv", help="pressure_kPa, angle_deg of inflation and deflation"
    )
    add_option(fit, "--out", help="draw the figure there")
    add_option(fit, "--json")
    fit.set_defaults(run=_vine_fit)


def _vine_fit(arguments: argparse.Namespace) -> int:
    folder: Path | None = arguments.out
    with needs_analysis():
        from flying_vines.identification.bend_curve import PairsError, fit, load_pairs
        from flying_vines.identification.bend_curve.show import as_json, draw, show
    figures: Sequence[Path] = ()
    with file_errors(folder, PairsError):
        found = fit(load_pairs(arguments.pairs))
        if folder:
            folder.mkdir(parents=True, exist_ok=True)
            with needs_analysis():
                figures = draw(found, folder, f"{arguments.pairs.name}: bend against pressure")
    return show_found(arguments.json, lambda: as_json(found), lambda console: show(found, console), figures)
