"""Shared by all figures of a report: width, fonts, colours, and the data that the figures compare."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from textwrap import fill
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from flying_vines.identification.evidence import Compared
from flying_vines.identification.residuals import CHANNELS
from flying_vines.identification.simulate import GAP
from flying_vines.identification.verdict import Verdict
from flying_vines.physics.arrays import Array
from flying_vines.plots.style import BLUE, ORANGE, plain

WIDTH_IN = 6.4
BEFORE, AFTER = ORANGE, BLUE
MEASURED = "#b4bac3"
"""A light colour, because the points are large and lie behind the lines."""
INK = "#33383f"
_LEGEND = 52
"""Characters per line of a legend."""
_TYPE: dict[Any, Any] = {
    "font.size": 8.5,
    "axes.titlesize": 8.5,
    "axes.labelsize": 8.5,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "axes.titlelocation": "left",
    "axes.edgecolor": "#9aa0a8",
    "axes.linewidth": 0.7,
    "text.color": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "svg.fonttype": "path",
    "svg.hashsalt": "report",
}


@contextmanager
def typeset() -> Iterator[None]:
    """The style in which the figures of a report are drawn and saved."""
    with matplotlib.rc_context(_TYPE):
        yield


def blank(height_in: float) -> Figure:
    """An empty figure of the common width. It need not be closed."""
    return Figure(figsize=(WIDTH_IN, height_in), layout="constrained")


def quiet(axis: Any, title: str = "") -> None:
    """Give an axis a plain style with small ticks, and a title if there is one."""
    plain(axis)
    axis.tick_params(length=2.5, width=0.7)
    if title:
        axis.set_title(title, pad=4)


def models(verdict: Verdict) -> str:
    """The causes of the extended model; empty if it is the baseline."""
    return " + ".join(dict.fromkeys(profile.cause for profile in verdict.evidence.profiles))


def extended(model: str) -> str:
    """The text of a legend for the extended model."""
    return fill(f"extended: {model}", _LEGEND, break_long_words=False)


def channels(verdict: Verdict) -> list[int]:
    """Rows in `CHANNELS` that have readings."""
    return [
        row
        for row in range(len(CHANNELS))
        if any(np.isfinite(run.measured_kPa[row]).any() for run in verdict.evidence.runs)
    ]


def residuals(run: Compared, row: int, noise_kPa: tuple[float, float]) -> tuple[Array, Array]:
    """(n,) each: before and after, measured minus simulated in units of noise; NaN without a reading."""
    before, after = (
        (run.measured_kPa[row] - simulated[row]) / noise_kPa[row]
        for simulated in (run.baseline_kPa, run.extended_kPa)
    )
    return before, after


def unbroken(time_s: Array, values: Array) -> tuple[Array, Array]:
    """A line that is interrupted at the gaps of the recording."""
    steps_s = np.diff(time_s)
    usual_s = np.median(steps_s) if len(steps_s) else 0.0
    gaps = np.flatnonzero(steps_s > GAP * usual_s) + 1
    return np.insert(time_s, gaps, np.nan), np.insert(values, gaps, np.nan)
