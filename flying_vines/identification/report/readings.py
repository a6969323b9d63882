"""Figures of the readings: runs, measured and simulated, and residuals. Also what all figures share."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from textwrap import fill
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullFormatter

from flying_vines.identification.evidence import Compared
from flying_vines.identification.residuals import CHANNELS, IN_STRETCHES, Pattern
from flying_vines.identification.simulate import GAP
from flying_vines.identification.verdict import UNEXPLAINED, Verdict
from flying_vines.physics.arrays import Array, BoolArray
from flying_vines.plots.style import BLUE, GREEN, GREY, ORANGE, plain

WIDTH_IN = 6.4
BEFORE, AFTER = ORANGE, BLUE
MEASURED = "#b4bac3"
"""A light colour, because the points are large and lie behind the lines."""
INK = "#33383f"
_LEGEND = 52
"""Characters per line of a legend."""
_ZOOM = 0.09
"""Share of a run that is enlarged, at least `_MIN_ZOOM_S` and `_MIN_SAMPLES`."""
_MIN_ZOOM_S = 1.5
_MIN_SAMPLES = 25
_MARKED = "#f1f2f4"
BAND = 2.0
"""Half width of the grey band, in standard deviations."""
_MIN_SPAN = 4.5
_BINS = 45
_NARROW = 15.0
"""In wider panels the normal distribution would be too narrow to see."""
_LAGS = 60
_PER_CHANNEL = 3
_SINCE = "time since"
_LINE = 26
"""Characters per line of an axis label."""
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


def legend_above(figure: Figure, axis: Any, **options: Any) -> None:
    """A legend above the figure, with the labels of one axis."""
    figure.legend(*axis.get_legend_handles_labels(), loc="outside upper left", **options)


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
    legend_above(figure, axes[0, 0], ncols=3, markerscale=1.8, handlelength=1.6)
    return figure


def _pressure(axis: Any, run: Compared, row: int, model: str, kept: BoolArray, whole: bool) -> None:
    time_s = run.time_s[kept]
    points: dict[str, Any] = {"ms": 2.6 if whole else 4.0, "mew": 0, "color": MEASURED, "rasterized": True}
    axis.plot(time_s, run.measured_kPa[row, kept], "o", label="measured", **points)
    axis.plot(*unbroken(time_s, run.baseline_kPa[row, kept]), color=BEFORE, lw=1.2, label="baseline")
    if model:
        axis.plot(*unbroken(time_s, run.extended_kPa[row, kept]), color=AFTER, lw=1.0, label=extended(model))


def _openings(axis: Any, run: Compared) -> None:
    evp, dvp, solenoid = run.openings
    style: dict[str, Any] = {"lw": 0.4, "step": "post", "rasterized": True}
    axis.fill_between(run.time_s, evp, color=BLUE, alpha=0.6, **style)
    axis.fill_between(run.time_s, -dvp, color=GREEN, alpha=0.7, **style)
    axis.fill_between(run.time_s, -1.5, -1.2, where=solenoid > 0.5, color=GREY, **style)
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


def draw_residuals(verdict: Verdict) -> Figure:
    """Residuals in units of noise over all runs, before and after, with their histograms."""
    afters = (False, True) if models(verdict) else (False,)
    panels = [(row, after) for row in channels(verdict) for after in afters]
    figure = blank(0.35 + 1.2 * len(panels))
    axes = figure.subplots(len(panels), 2, squeeze=False, sharey="row", width_ratios=[4.2, 1.0])
    for (row, after), (series, histogram) in zip(panels, axes, strict=True):
        _panel(verdict, row, after, series, histogram)
    for series in axes[:-1, 0]:
        series.tick_params(labelbottom=False)
    axes[-1, 0].set_xlabel("time, s; one run after the other")
    return figure


def _panel(verdict: Verdict, row: int, after: bool, series: Any, histogram: Any) -> None:
    color = AFTER if after else BEFORE
    begin_s, every = 0.0, []
    for run in verdict.evidence.runs:
        residual = residuals(run, row, verdict.evidence.noise_kPa)[after]
        time_s = begin_s + run.time_s - run.time_s[0]
        series.plot(time_s, residual, color=color, ls="none", marker="o", ms=0.9, mew=0, rasterized=True)
        if begin_s > 0.0:
            series.axvline(begin_s, color=INK, lw=0.5, ls=(0, (2, 3)))
        begin_s = time_s[-1]
        every.append(residual[np.isfinite(residual)])
    values = np.concatenate(every)
    span = max(_MIN_SPAN, 1.05 * float(np.abs(values).max(initial=0.0)))
    for axis in (series, histogram):
        axis.axhspan(-BAND, BAND, color=INK, alpha=0.12, lw=0)
    edges = np.linspace(-span, span, _BINS + 1)
    density, *_ = histogram.hist(
        values, edges, orientation="horizontal", density=True, color=color, alpha=0.75
    )
    if span < _NARROW:
        x = np.linspace(-span, span, 200)
        histogram.plot(np.exp(-0.5 * x**2) / np.sqrt(2.0 * np.pi), x, color=INK, lw=0.9)
    histogram.set_xlim(0.0, 1.15 * float(density.max()))
    histogram.set_xticks([])
    series.set_xlim(0.0, begin_s)
    series.set_ylim(-span, span)
    series.yaxis.set_major_locator(MaxNLocator(5, integer=True))
    inside = float(np.mean(np.abs(values) < BAND))
    what = "extended" if after else "baseline"
    quiet(series, f"{CHANNELS[row]}, {what}: {100.0 * inside:.0f} % within ±{BAND:g}σ")
    quiet(histogram)
    histogram.grid(False)
    series.set_ylabel("σ")


def draw_autocorrelation(verdict: Verdict) -> Figure:
    """Autocorrelation of the residuals. For noise alone, 95 of 100 points lie in the band."""
    read, model = channels(verdict), models(verdict)
    figure = blank(1.9)
    axes = figure.subplots(1, len(read), squeeze=False, sharey=True)[0]
    for row, axis in zip(read, axes, strict=True):
        for after in (False, True) if model else (False,):
            lagged, readings = _autocorrelation(verdict, row, after)
            lags = np.arange(1, len(lagged) + 1)
            color, label = (AFTER, extended(model)) if after else (BEFORE, "baseline")
            axis.plot(lags, lagged, "o-", color=color, lw=0.8, ms=2.2, mew=0, label=label)
        axis.axhspan(-1.96 / readings**0.5, 1.96 / readings**0.5, color=INK, alpha=0.15, lw=0)
        axis.set_xlim(0.0, _LAGS)
        axis.set_xlabel("samples apart")
        quiet(axis, CHANNELS[row])
    axes[0].set_ylabel("correlation")
    legend_above(figure, axes[0], ncols=2)
    return figure


def _autocorrelation(verdict: Verdict, row: int, after: bool) -> tuple[Array, int]:
    """(lags,) autocorrelation from lag 1 on, over pairs within a run; and the number of readings."""
    products, squares, readings = np.zeros(_LAGS), 0.0, 0
    pairs = np.zeros(_LAGS)
    for run in verdict.evidence.runs:
        residual = residuals(run, row, verdict.evidence.noise_kPa)[after]
        there = np.isfinite(residual)
        residual = np.where(there, residual, 0.0)
        squares += float(residual @ residual)
        readings += int(there.sum())
        for lag in range(1, min(_LAGS, len(residual) - 1) + 1):
            products[lag - 1] += residual[:-lag] @ residual[lag:]
            pairs[lag - 1] += np.count_nonzero(there[:-lag] & there[lag:])
    kept = pairs > 0
    return products[kept] / pairs[kept] / (squares / readings), readings


def strongest(verdict: Verdict) -> list[Pattern]:
    """The features on which the residuals of each channel depend most.

    The residuals are those of the baseline, or of the best fit if the verdict is unexplained.
    """
    evidence = verdict.evidence
    leading = evidence.after if verdict.cause == UNEXPLAINED else evidence.before
    # Of patterns with p below 1e-300, the one with the largest means is the strongest.
    ranked = sorted(leading, key=lambda p: (-min(p.log_p, 300.0), -float(p.count @ p.mean**2)))
    kinds: dict[tuple[str, str], Pattern] = {}
    for pattern in ranked:
        # The residuals over time already show stretches of time.
        if not pattern.feature.startswith(IN_STRETCHES):
            kinds.setdefault((pattern.channel, _kind(pattern.feature)), pattern)
    return [
        pattern
        for channel in CHANNELS
        for pattern in [p for p in kinds.values() if p.channel == channel][:_PER_CHANNEL]
    ]


def _kind(feature: str) -> str:
    """The kind of a feature. Times since a valve opened and since it closed are one kind."""
    return feature.rsplit(maxsplit=1)[0] if feature.startswith(_SINCE) else feature


def same(pattern: Pattern, others: tuple[Pattern, ...]) -> Pattern | None:
    """The pattern of the same channel and feature."""
    return next((p for p in others if (p.channel, p.feature) == (pattern.channel, pattern.feature)), None)


def draw_dependence(verdict: Verdict) -> Figure:
    """Mean residual per group of samples with twice its standard error, before and after."""
    shown, model = strongest(verdict), models(verdict)
    across = _PER_CHANNEL
    down = -(-len(shown) // across)
    figure = blank(0.35 + 1.95 * down)
    axes = figure.subplots(down, across, squeeze=False)
    for axis in axes.flat[len(shown) :]:
        axis.set_axis_off()
    for pattern, axis in zip(shown, axes.flat, strict=False):
        before, after = (same(pattern, p) for p in (verdict.evidence.before, verdict.evidence.after))
        axis.axhline(0.0, color=INK, lw=0.6)
        if before is not None:
            _means(axis, before, BEFORE, "baseline")
        if after is not None and model:
            _means(axis, after, AFTER, extended(model))
        if pattern.feature.startswith(_SINCE):
            axis.set_xscale("log")
            axis.xaxis.set_major_formatter("{x:g}")
            axis.xaxis.set_minor_formatter(NullFormatter())
        unit = f", {pattern.unit}" if pattern.unit else ""
        axis.set_xlabel(fill(pattern.feature + unit, _LINE))
        quiet(axis, pattern.channel)
    for row in axes:
        row[0].set_ylabel("mean residual, σ")
    legend_above(figure, axes[0, 0], ncols=2)
    return figure


def _means(axis: Any, pattern: Pattern, color: str, label: str) -> None:
    order = np.argsort(pattern.centre)
    x, y, error = pattern.centre[order], pattern.mean[order], 2.0 / np.sqrt(pattern.count[order])
    style: dict[str, Any] = {"lw": 0.9, "elinewidth": 0.9, "ms": 3.2, "mew": 0, "capsize": 0}
    axis.errorbar(x, y, error, fmt="o-", color=color, label=label, **style)
