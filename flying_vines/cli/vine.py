"""`flying-vines vine fit`: a bend curve from measured pairs."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from flying_vines.cli.common import file_errors, needs_analysis, show_found


def add(commands: Any) -> None:
    """Add `vine` to the parsers of the command line."""
    vine = commands.add_parser("vine", help="the bend curve of a vine")
    actions = vine.add_subparsers(metavar="ACTION", required=True)
    fit = actions.add_parser("fit", help="fit a bend curve to measured pairs")
    fit.add_argument(
        "pairs", type=Path, metavar="PAIRS.csv", help="pressure_kPa, angle_deg of inflation and deflation"
    )
    fit.add_argument("--out", type=Path, metavar="DIR", help="draw the figure there")
    fit.add_argument("--json", action="store_true", help="print JSON instead")
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
