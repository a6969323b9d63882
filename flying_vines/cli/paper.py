"""`flying-vines paper`: every number of the paper beside ours."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from flying_vines.cli.common import file_errors, needs_analysis, progress_bar, show_found


def add(commands: Any) -> None:
    """Add `paper` to the parsers of the command line."""
    paper = commands.add_parser("paper", help="reproduce the phloSAR paper: all its numbers beside ours")
    paper.add_argument("--out", type=Path, metavar="DIR", help="draw the figures there")
    paper.add_argument(
        "--diagnose", action="store_true", help="find why the paper's measurements differ from its model"
    )
    paper.add_argument("--json", action="store_true", help="print one JSON object instead")
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
