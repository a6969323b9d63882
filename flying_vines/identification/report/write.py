"""The files of a report."""

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
"""Of the dots of a picture; its lines and letters are drawn at any size."""


def write_report(verdict: Verdict, case: Case, folder: Path) -> list[Path]:
    """Write a verdict into a folder, which is made if it is not there: a page, an object, and the pictures.

    Args:
        verdict: of `diagnose(case)`.
        case: what it was made of.
        folder: gets `report.html`, which holds all that it shows and opens offline; `verdict.json`, as
            `diagnose --json` prints it; and each of `figures` as an SVG file. What has these names is
            replaced.

    Returns:
        the files, the page first. The same verdict makes the same bytes.
    """
    pictures = {name: svg(figure) for name, figure in figures(verdict).items()}
    content = {
        # A file's name may hold bytes that are no text.
        REPORT: page(verdict, case, pictures).encode("utf-8", "replace"),
        VERDICT: json.dumps(verdict.as_json(), indent=2, allow_nan=False).encode() + b"\n",
        **{f"{name}.svg": svg for name, svg in pictures.items()},
    }
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in content.items():
        (folder / name).write_bytes(data)
    return [folder / name for name in content]


def svg(figure: Figure) -> bytes:
    """A figure as a file, the same whenever it is made."""
    with typeset(), BytesIO() as file:
        figure.savefig(file, format="svg", dpi=_DPI, metadata={"Date": None, "Creator": None})
        return file.getvalue()
