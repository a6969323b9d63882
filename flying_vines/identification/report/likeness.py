"""Which causes look alike in these data."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.cluster.hierarchy import leaves_list, linkage
from scipy.spatial.distance import squareform

from flying_vines.identification.likeness import Likeness
from flying_vines.identification.report.canvas import AFTER, blank, quiet
from flying_vines.identification.verdict import Verdict
from flying_vines.plots.style import GREY

SEEN = 5.0
"""Standard deviations; a shorter trace has no direction that counts."""
ALIKE = 0.95
_WRITTEN = 0.5
_DARK = 0.7


def draw_likeness(verdict: Verdict) -> Figure:
    """Cosine between each two causes' traces, like beside like, and how plainly each shows; those that do."""
    likeness = verdict.evidence.likeness
    order = by_likeness(likeness)
    count = len(order)
    names = [likeness.causes[i] for i in order]
    figure = blank(1.6 + 0.2 * count)
    matrix, bars = figure.subplots(1, 2, width_ratios=[5.0, 1.0])
    matrix.imshow(likeness.cosine[np.ix_(order, order)], cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for y, i in enumerate(order):
        for x, j in enumerate(order):
            if x != y and likeness.cosine[i, j] >= _WRITTEN:
                color = "white" if likeness.cosine[i, j] > _DARK else "black"
                percent = f"{100.0 * likeness.cosine[i, j]:.0f}"
                matrix.text(x, y, percent, ha="center", va="center", fontsize=6, color=color)
    matrix.set_xticks(range(count), names, rotation=90)
    matrix.set_yticks(range(count), names)
    found = {*(named.cause for named in verdict.named), *verdict.indistinguishable}
    for label in (*matrix.get_xticklabels(), *matrix.get_yticklabels()):
        if label.get_text() in found:
            label.set(color=AFTER, fontweight="bold")
    matrix.tick_params(length=0)
    matrix.spines[:].set_visible(False)
    matrix.set_title("alike, %", pad=4)
    bars.barh(range(count), likeness.seen[order], color=GREY, height=0.7, log=True)
    bars.set_xlim(left=1.0)
    bars.set_ylim(matrix.get_ylim())
    bars.set_yticks([])
    quiet(bars, "shows, σ")
    return figure


def by_likeness(likeness: Likeness) -> NDArray[np.intp]:
    """Of the causes that would be seen, an order in which those that look alike are neighbours."""
    seen = np.flatnonzero(likeness.seen >= SEEN)
    if len(seen) < 3:
        return seen
    distance = np.clip(1.0 - likeness.cosine[np.ix_(seen, seen)], 0.0, 1.0)
    np.fill_diagonal(distance, 0.0)
    order: NDArray[np.intp] = leaves_list(
        linkage(squareform(distance, checks=False), "average", optimal_ordering=True)
    )
    return seen[order]


def alike_pairs(likeness: Likeness) -> list[tuple[str, str, float]]:
    """Pairs that these data hardly tell apart, the most alike first."""
    seen = np.flatnonzero(likeness.seen >= SEEN)
    pairs = [
        (likeness.causes[i], likeness.causes[j], float(likeness.cosine[i, j]))
        for place, i in enumerate(seen)
        for j in seen[place + 1 :]
        if likeness.cosine[i, j] >= ALIKE
    ]
    return sorted(pairs, key=lambda pair: -pair[2])
