"""What the residuals depend on: the fingerprint of what is missing, and whether it has gone."""

from __future__ import annotations

from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from flying_vines.identification.report.canvas import AFTER, BEFORE, INK, blank, extended, models, quiet
from flying_vines.identification.residuals import CHANNELS, Pattern
from flying_vines.identification.verdict import UNEXPLAINED, Verdict

_PER_CHANNEL = 3
_OVER_TIME = "time in stretches"
"""How features begin that the residuals themselves show, over time."""
_SINCE = "time since"
_LINE = 26
"""Characters of an axis' label."""


def strongest(verdict: Verdict) -> list[Pattern]:
    """The few things that a channel depends on most, channel by channel: of what there was to explain, or
    where that has failed, of what is left."""
    evidence = verdict.evidence
    leading = evidence.after if verdict.cause == UNEXPLAINED else evidence.before
    # Where all are certain, the strongest is where the means are largest.
    ranked = sorted(leading, key=lambda p: (-min(p.surprise, 300.0), -float(p.count @ p.mean**2)))
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
    """Times since a valve opened, and since it closed, are of a kind: one of them is enough."""
    return feature.rsplit(maxsplit=1)[0] if feature.startswith(_SINCE) else feature


def same(pattern: Pattern, others: tuple[Pattern, ...]) -> Pattern | None:
    """The one of the same channel and feature."""
    return next((p for p in others if (p.channel, p.feature) == (pattern.channel, pattern.feature)), None)


def draw_dependence(verdict: Verdict) -> Figure:
    """Mean residual per group of samples, with twice its standard error, before and after."""
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
