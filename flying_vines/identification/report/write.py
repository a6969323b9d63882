"""Writes the files of a report."""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path

from matplotlib.figure import Figure

from flying_vines.identification.case import Case
from flying_vines.identification.report.canvas import typeset
from flying_vines.identification.report.figures import figures
from flying_vines.identification.report.page import page
from flying_vines.identification.verdict import Verdict

REPORT, VERDICT = "report.html", "verdict.json"
_DPI = 200
"""Resolution of the rasterized points; lines and text are vectors."""


def write_report(verdict: Verdict, case: Case, folder: Path) -> list[Path]:
    """Write a verdict into a folder, which is made if needed: the page, the verdict as JSON, and the figures.

    Args:
        verdict: the result of `diagnose(case)`.
        case: the data of the verdict.
        folder: gets `report.html`, which opens offline; `verdict.json`, the content of `diagnose --json`; and
            each of `figures` as an SVG file. Existing files of these names are replaced.

    Returns:
        the paths of the files, the page first. The same verdict gives the same bytes.
    """
    pictures = {name: svg(figure) for name, figure in figures(verdict).items()}
    content = {
        # The name of a file can contain bytes that are not text.
        REPORT: page(verdict, case, pictures).encode("utf-8", "replace"),
        VERDICT: json.dumps(verdict.as_json(), indent=2, allow_nan=False).encode() + b"\n",
        **{f"{name}.svg": svg for name, svg in pictures.items()},
    }
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in content.items():
        (folder / name).write_bytes(data)
    return [folder / name for name in content]


def svg(figure: Figure) -> bytes:
    """A figure as an SVG file, the same bytes each time."""
    with typeset(), BytesIO() as file:
        figure.savefig(file, format="svg", dpi=_DPI, metadata={"Date": None, "Creator": None})
        return file.getvalue()
