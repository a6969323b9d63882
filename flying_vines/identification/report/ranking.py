"""Everything that was tried, by evidence."""

from __future__ import annotations

from math import isfinite

import numpy as np
from matplotlib.figure import Figure

from flying_vines.identification.report.canvas import AFTER, BEFORE, INK, blank, quiet
from flying_vines.identification.search import CLAIM
from flying_vines.identification.verdict import Tried, Verdict
from flying_vines.plots.style import GREY, PURPLE

MOST = 16


def shown(verdict: Verdict) -> list[Tried]:
    """The best, and the baseline wherever it stands."""
    fitted = [tried for tried in verdict.ranking if isfinite(tried.score)]
    return fitted[:MOST] + [tried for tried in fitted[MOST:] if not tried.causes]


def color_of(tried: Tried, verdict: Verdict) -> str:
    """By its part in the verdict."""
    if not tried.causes:
        return BEFORE
    named = {named.cause for named in verdict.named}
    if set(tried.causes) == named:
        return AFTER
    # In place of one of them, whichever it is.
    others = set(tried.causes) - named
    alike = len(others) == 1 and others <= set(verdict.indistinguishable)
    return PURPLE if alike and len(tried.causes) == len(named) else GREY


def draw_ranking(verdict: Verdict) -> Figure:
    """How much evidence each candidate lies behind the best: the logarithm of how much likelier that is."""
    rows = shown(verdict)
    figure = blank(0.75 + 0.2 * len(rows))
    axis = figure.subplots()
    behind = np.array([0.5 * tried.score for tried in rows])
    for y, (tried, x) in enumerate(zip(rows, behind, strict=True)):
        color = color_of(tried, verdict)
        axis.plot([0.0, x], [y, y], color=color, lw=1.4, alpha=0.45, solid_capstyle="butt")
        axis.plot(x, y, "o", ms=5, color=color, mfc="white" if tried.on_bound else color, mew=1.2)
        if tried.unseen_nrmse is not None:
            axis.annotate(
                f"unseen {100.0 * tried.unseen_nrmse:.3g} %",
                (x, y),
                (7, 0),
                textcoords="offset points",
                va="center",
                fontsize=7.5,
                color=INK,
                annotation_clip=False,
            )
    axis.set_xscale("symlog", linthresh=10.0, linscale=0.8)
    axis.set_xlim(-0.5, max(100.0, 12.0 * behind.max(initial=0.0)))
    axis.axvspan(-0.5, 0.5 * CLAIM, color=INK, alpha=0.07, lw=0)
    axis.set_yticks(range(len(rows)), [" + ".join(tried.causes) or "baseline" for tried in rows])
    axis.set_ylim(len(rows) - 0.4, -0.6)
    axis.set_xlabel("ln evidence behind the best")
    quiet(axis)
    axis.grid(axis="y", visible=False)
    return figure
