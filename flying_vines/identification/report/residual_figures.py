"""Figures of the residuals: over time, autocorrelation, and dependence on features."""

from __future__ import annotations

from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullFormatter

from flying_vines.identification.report.canvas import (
    AFTER,
    BEFORE,
    INK,
    blank,
    channels,
    extended,
    models,
    quiet,
    residuals,
)
from flying_vines.identification.residuals import CHANNELS, Pattern
from flying_vines.identification.verdict import UNEXPLAINED, Verdict
from flying_vines.physics.arrays import Array

BAND = 2.0
"""Half width of the grey band, in standard deviations."""
_MIN_SPAN = 4.5
_BINS = 45
_NARROW = 15.0
"""In wider panels the normal distribution would be too narrow to see."""
_LAGS = 60
_PER_CHANNEL = 3
_OVER_TIME = "time in stretches"
"""First words of features that the residuals over time already show."""
_SINCE = "time since"
_LINE = 26
"""Characters per line of an axis label."""


def draw_residuals(verdict: Verdict) -> Figure:
    """Residuals in units of noise over all runs, before and after, with their histograms."""
    panels = [
        (row, after)
        for row in channels(verdict)
        for after in ((False, True) if models(verdict) else (False,))
    ]
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
    read = channels(verdict)
    figure = blank(1.9)
    axes = figure.subplots(1, len(read), squeeze=False, sharey=True)[0]
    for row, axis in zip(read, axes, strict=True):
        for after, color in ((False, BEFORE), (True, AFTER)):
            if after and not models(verdict):
                continue
            lagged, readings = _autocorrelation(verdict, row, after)
            axis.plot(
                np.arange(1, len(lagged) + 1),
                lagged,
                color=color,
                lw=0.8,
                marker="o",
                ms=2.2,
                mew=0,
                label=extended(models(verdict)) if after else "baseline",
            )
        axis.axhspan(-1.96 / readings**0.5, 1.96 / readings**0.5, color=INK, alpha=0.15, lw=0)
        axis.set_xlim(0.0, _LAGS)
        axis.set_xlabel("samples apart")
        quiet(axis, CHANNELS[row])
    axes[0].set_ylabel("correlation")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=2)
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
        if not pattern.feature.startswith(_OVER_TIME):
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
    shown = strongest(verdict)
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
        if after is not None and models(verdict):
            _means(axis, after, AFTER, extended(models(verdict)))
        if pattern.feature.startswith(_SINCE):
            axis.set_xscale("log")
            axis.xaxis.set_major_formatter("{x:g}")
            axis.xaxis.set_minor_formatter(NullFormatter())
        unit = f", {pattern.unit}" if pattern.unit else ""
        axis.set_xlabel(fill(pattern.feature + unit, _LINE))
        quiet(axis, pattern.channel)
    for row in axes:
        row[0].set_ylabel("mean residual, σ")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=2)
    return figure


def _means(axis: Any, pattern: Pattern, color: str, label: str) -> None:
    order = np.argsort(pattern.centre)
    axis.errorbar(
        pattern.centre[order],
        pattern.mean[order],
        2.0 / np.sqrt(pattern.count[order]),
        color=color,
        lw=0.9,
        elinewidth=0.9,
        marker="o",
        ms=3.2,
        mew=0,
        capsize=0,
        label=label,
    )
