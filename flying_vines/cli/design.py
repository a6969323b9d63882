"""`flying-vines design`: finds the phloSAR that a robot needs."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from flying_vines.cli.common import file_errors, needs_analysis, show_found


def add(commands: Any) -> None:
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
    design.add_argument("--out", type=Path, metavar="DIR", help="draw the figures there")
    design.add_argument("--json", action="store_true", help="print one JSON object instead")
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
