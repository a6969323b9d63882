"""Figure of one run, measured and simulated; the stretch in which the simulations differ most is enlarged."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from flying_vines.identification.evidence import Compared
from flying_vines.identification.report.canvas import (
    AFTER,
    BEFORE,
    INK,
    MEASURED,
    blank,
    extended,
    quiet,
    unbroken,
)
from flying_vines.identification.residuals import CHANNELS
from flying_vines.physics.arrays import Array, BoolArray
from flying_vines.plots.style import BLUE, GREEN, GREY

_ZOOM = 0.09
"""Share of a run that is enlarged, at least `_MIN_ZOOM_S` and `_MIN_SAMPLES`."""
_MIN_ZOOM_S = 1.5
_MIN_SAMPLES = 25
_MARKED = "#f1f2f4"


def model_difference(run: Compared, noise_kPa: tuple[float, float], model: str) -> Array:
    """(n,) difference of the simulations in units of noise; without a model, the error of the baseline."""
    other_kPa = run.extended_kPa if model else run.measured_kPa
    apart = (other_kPa - run.baseline_kPa) / np.array(noise_kPa)[:, None]
    difference: Array = np.linalg.norm(np.where(np.isfinite(run.measured_kPa), apart, 0.0), axis=0)
    return difference


def draw_run(run: Compared, noise_kPa: tuple[float, float], model: str) -> Figure:
    """Pressures above openings: the whole run on the left, the enlarged stretch on the right.

    Args:
        noise_kPa: standard deviations of the noise of control volume and reservoir.
        model: the name of the extended model; empty if it is the baseline.
    """
    read = [row for row in range(len(CHANNELS)) if np.isfinite(run.measured_kPa[row]).any()]
    figure = blank(0.75 + 1.35 * len(read) + 0.75)
    heights = [1.35] * len(read) + [0.75]
    axes = figure.subplots(
        len(heights), 2, sharex="col", squeeze=False, width_ratios=[1.9, 1.0], height_ratios=heights
    )
    zoom = _zoom(run, noise_kPa, model)
    for row, (left, right) in zip(read, axes, strict=False):
        _pressure(left, run, row, model, np.ones_like(zoom), whole=True)
        _pressure(right, run, row, model, zoom, whole=False)
        left.set_title(CHANNELS[row])
        left.set_ylabel("kPa gauge")
    for axis in axes[-1]:
        _openings(axis, run)
    for column, kept in enumerate((np.ones_like(zoom), zoom)):
        time_s = run.time_s[kept]
        axes[-1, column].set_xlim(time_s[0], time_s[-1])
        axes[-1, column].set_xlabel("time, s")
    axes[0, 1].set_title("the shaded stretch")
    for left, _ in axes:
        left.axvspan(run.time_s[zoom][0], run.time_s[zoom][-1], color=_MARKED, lw=0, zorder=-10)
    for axis in axes.flat:
        quiet(axis)
    for _, right in axes:
        right.set_facecolor(_MARKED)
        right.grid(color="white")
    axes[-1, 1].set_yticklabels([])
    figure.align_ylabels(axes[:, 0])
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=3, markerscale=1.8, handlelength=1.6)
    return figure


def _pressure(axis: Any, run: Compared, row: int, model: str, kept: BoolArray, whole: bool) -> None:
    time_s = run.time_s[kept]
    axis.plot(
        time_s,
        run.measured_kPa[row, kept],
        ls="none",
        marker="o",
        ms=2.6 if whole else 4.0,
        mew=0,
        color=MEASURED,
        label="measured",
        rasterized=True,
    )
    axis.plot(*unbroken(time_s, run.baseline_kPa[row, kept]), color=BEFORE, lw=1.2, label="baseline")
    if model:
        axis.plot(*unbroken(time_s, run.extended_kPa[row, kept]), color=AFTER, lw=1.0, label=extended(model))


def _openings(axis: Any, run: Compared) -> None:
    evp, dvp, solenoid = run.openings
    axis.fill_between(run.time_s, evp, color=BLUE, alpha=0.6, lw=0.4, step="post", rasterized=True)
    axis.fill_between(run.time_s, -dvp, color=GREEN, alpha=0.7, lw=0.4, step="post", rasterized=True)
    axis.fill_between(
        run.time_s, -1.5, -1.2, where=solenoid > 0.5, color=GREY, lw=0.4, step="post", rasterized=True
    )
    axis.axhline(0.0, color=INK, lw=0.4)
    axis.set_ylim(-1.65, 1.1)
    axis.set_yticks([-1.35, -0.5, 0.5], ["solenoid", "Venturi's", "inflation"])


def _zoom(run: Compared, noise_kPa: tuple[float, float], model: str) -> BoolArray:
    """(n,) True in the stretch in which the simulations differ most."""
    time_s = run.time_s
    span_s = time_s[-1] - time_s[0]
    usual_s = float(np.median(np.diff(time_s)))
    width_s = min(span_s, max(_MIN_ZOOM_S, _ZOOM * span_s, _MIN_SAMPLES * usual_s))
    total = np.concatenate(([0.0], np.cumsum(model_difference(run, noise_kPa, model) ** 2)))
    ends = np.searchsorted(time_s, time_s + width_s, side="right")
    gained = np.where(time_s <= time_s[-1] - width_s + 1e-9, total[ends] - total[:-1], -1.0)
    start = int(np.argmax(gained))
    index = np.arange(len(time_s))
    inside: BoolArray = (index >= start) & (index < ends[start])
    return inside
