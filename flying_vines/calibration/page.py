"""The page of a calibration, and its pictures. Opens offline; needs matplotlib and Jinja2."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from flying_vines.calibration.findings import Chart, Findings, Series
from flying_vines.identification.report import filled, svg
from flying_vines.identification.report.readings import INK, blank, quiet, typeset
from flying_vines.plots.style import BLUE, GREEN, ORANGE, PURPLE, RED

POINTS = (BLUE, ORANGE, GREEN, PURPLE)
LINES = (INK, RED, PURPLE, ORANGE)
BAND = "#c9d6e8"
HEIGHT_IN = 3.4
MANY = 200
"""More points than this are drawn small."""
LEGEND = {"facecolor": "white", "edgecolor": "none", "framealpha": 0.85}
DPI = 200


def page(title: str, sentence: str, findings: Findings, pictures: Mapping[str, bytes]) -> str:
    """The whole page. `pictures`: SVG by the names of the charts."""
    return filled(
        Path(__file__).with_name("calibration.html"),
        pictures,
        title=title,
        sentence=sentence,
        findings=[(finding, *finding.texts(), finding.change()) for finding in findings.findings],
        notes=findings.notes(),
        charts=findings.charts,
    )


def pictures(charts: Sequence[Chart], folder: Path) -> dict[str, bytes]:
    """Write each chart as SVG and PNG into an existing folder. Returns the SVGs by chart name."""
    drawn = {}
    for chart in charts:
        figure = draw(chart)
        drawn[chart.name] = svg(figure)
        (folder / f"{chart.name}.svg").write_bytes(drawn[chart.name])
        with typeset():
            figure.savefig(folder / f"{chart.name}.png", dpi=DPI, metadata={"Software": None})
    return drawn


def draw(chart: Chart) -> Figure:
    """A figure with one panel."""
    with typeset():
        figure = blank(HEIGHT_IN)
        axis: Any = figure.subplots()
        quiet(axis, chart.title)
        points, lines = iter(POINTS * len(chart.series)), iter(LINES * len(chart.series))
        for series in chart.series:
            if series.kind == "band" and series.y2 is not None:
                axis.fill_between(
                    series.x, series.y, series.y2, color=BAND, lw=0, label=series.label, zorder=1
                )
            elif series.kind == "line":
                axis.plot(series.x, series.y, color=next(lines), lw=1.2, label=series.label, zorder=3)
            else:
                _points(axis, series, next(points))
        axis.set_xlabel(chart.x_label)
        axis.set_ylabel(chart.y_label)
        axis.margins(x=0.02, y=0.08)
        legend = axis.legend(frameon=True, **LEGEND)
        for handle in legend.legend_handles:
            if isinstance(handle, Line2D) and handle.get_marker() == "o":
                handle.set(markersize=4.0, alpha=1.0)
        if chart.note:
            figure.supxlabel(chart.note, x=0.01, ha="left", fontsize=8.0, color="#656c77")
        return figure


def _points(axis: Any, series: Series, color: str) -> None:
    look: dict[str, Any] = {"ms": 4.0, "mfc": "white", "mec": color, "mew": 1.0}
    if len(series.x) > MANY:
        look = {"ms": 1.2, "mfc": color, "mec": "none", "alpha": 0.5, "rasterized": True}
    axis.plot(series.x, series.y, ls="none", marker="o", label=series.label, zorder=2, **look)
