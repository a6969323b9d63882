"""Draws the matrix of a plan: the separation of each cause in the rig from each fitted cause."""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.colors import LinearSegmentedColormap, LogNorm

from flying_vines.identification.plan.cause_distance import SETTLED
from flying_vines.identification.plan.planning import RecordingPlan
from flying_vines.identification.verdict import NONE
from flying_vines.plots.style import BLUE, RED, finish

_MAX_SIGMAS = 1000.0
_DARK = 30.0
"""From this number of standard deviations on, a cell is dark and its number is white."""


def figures(plan: RecordingPlan) -> dict[str, Any]:
    """The figures of a plan, by name."""
    return {"matrix": _matrix(plan)}


def _matrix(plan: RecordingPlan) -> Any:
    sigmas = plan.sigmas.copy()
    np.fill_diagonal(sigmas, np.nan)
    lowest = sqrt(SETTLED)
    figure, axis = plt.subplots(figsize=(11.0, 9.0), layout="constrained")
    shades = LinearSegmentedColormap.from_list("settled", ["#eef3fa", BLUE, "#0f2a4d"])
    colours = shades.with_extremes(under=RED)
    image = axis.imshow(
        np.maximum(sigmas, 1e-3),
        cmap=colours,
        norm=LogNorm(lowest, _MAX_SIGMAS),
        aspect="auto",
        interpolation="none",
    )
    for (row, column), value in np.ndenumerate(sigmas):
        if np.isfinite(value):
            colour = "white" if value > _DARK or value < lowest else "black"
            text = f"{value:.0f}" if value < 999.5 else f"{value / 1000.0:.0f}k"
            axis.text(column, row, text, ha="center", va="center", fontsize=7, color=colour)
    fitted = [*plan.names, NONE]
    axis.set_xticks(range(len(fitted)), fitted, rotation=55, ha="right", rotation_mode="anchor", fontsize=8)
    axis.set_yticks(range(len(plan.names)), plan.names, fontsize=8)
    axis.set_xlabel("fitted")
    axis.set_ylabel("cause in the rig, at its typical strength")
    bar = figure.colorbar(image, ax=axis, extend="min", pad=0.01)
    bar.set_label(f"standard deviations; red: not separated, below {lowest:g}")
    seconds, air_SL = plan.best.seconds, plan.best.air_SL
    finished = finish(
        figure,
        f"Separation by {len(plan.best.runs)} runs: {seconds:.0f} s, {air_SL:.1f} standard litres of air",
    )
    axis.grid(False)
    return finished
