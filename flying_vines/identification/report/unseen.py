"""What the verdict is worth: errors on data that no fit saw."""

from __future__ import annotations

from matplotlib.figure import Figure

from flying_vines.identification.report.canvas import AFTER, BEFORE, INK, blank, models, quiet
from flying_vines.identification.report.words import share
from flying_vines.identification.verdict import Verdict
from flying_vines.plots.style import GREY


def draw_unseen(verdict: Verdict) -> Figure:
    """Root mean square error over the range of what was measured, before, after, and of noise alone."""
    errors = verdict.held_out
    bars = [("baseline", errors.nrmse_before, BEFORE)]
    if models(verdict):
        bars.append(("extended", errors.nrmse_after, AFTER))
    bars.append(("noise alone", errors.noise_floor, GREY))
    figure = blank(0.5 + 0.28 * len(bars))
    axis = figure.subplots()
    most = max(value for _, value, _ in bars)
    for y, (_, value, color) in enumerate(bars):
        axis.barh(y, 100.0 * value, height=0.62, color=color)
        axis.annotate(
            share(value), (100.0 * value, y), (5, 0), textcoords="offset points", va="center", color=INK
        )
    axis.axvline(100.0 * errors.noise_floor, color=GREY, lw=0.8, ls=(0, (3, 3)))
    axis.set_yticks(range(len(bars)), [label for label, _, _ in bars])
    axis.set_ylim(len(bars) - 0.5, -0.5)
    axis.set_xlim(0.0, 115.0 * most if most > 0.0 else 1.0)
    axis.set_xlabel("error on unseen data, % of the measured range")
    quiet(axis)
    axis.grid(axis="y", visible=False)
    return figure
