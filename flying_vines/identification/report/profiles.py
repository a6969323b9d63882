"""How well the data fix what was measured: profiles of χ²."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from flying_vines.identification.intervals import ABOVE, Profile
from flying_vines.identification.model import Array
from flying_vines.identification.report.canvas import AFTER, INK, blank, quiet
from flying_vines.identification.report.words import label_and_unit, labelled, numbers
from flying_vines.identification.verdict import Estimate, Verdict

_MOST_ACROSS = 3
_HIGHEST = 1.6 * ABOVE


def draw_profiles(verdict: Verdict) -> Figure:
    """χ² above its least over each parameter, all else refitted, with the 95 % interval; of named causes."""
    profiles = verdict.evidence.profiles
    across = min(_MOST_ACROSS, max(2, len(profiles)))
    down = -(-len(profiles) // across)
    figure = blank(2.1 * down)
    axes = figure.subplots(down, across, squeeze=False)
    for axis in axes.flat[len(profiles) :]:
        axis.set_axis_off()
    for profile, axis in zip(profiles, axes.flat, strict=False):
        _draw(axis, profile)
    for row in axes:
        row[0].set_ylabel("χ² above its least")
    return figure


def _draw(axis: Any, profile: Profile) -> None:
    axis.axvspan(profile.low, profile.high, color=AFTER, alpha=0.12, lw=0)
    axis.axhline(ABOVE, color=INK, lw=0.8, ls=(0, (4, 3)))
    axis.axvline(profile.estimate, color=AFTER, lw=0.8)
    axis.plot(*curve(profile), color=AFTER, lw=1.3)
    near = profile.above <= _HIGHEST
    axis.plot(profile.value[near], profile.above[near], "o", ms=3.5, color=AFTER)
    below, beyond = profile.estimate - profile.low, profile.high - profile.estimate
    margin = 0.6 * max(below, beyond, 1e-12 * abs(profile.estimate))
    axis.set_xlim(profile.low - margin, profile.high + margin)
    axis.set_ylim(-0.3, _HIGHEST)
    axis.locator_params(axis="x", nbins=4)
    axis.ticklabel_format(useOffset=False)
    estimate, low, high = numbers(Estimate(profile.estimate, profile.low, profile.high))
    quiet(axis, f"{profile.cause}\n{estimate} ({low} … {high}) {label_and_unit(profile.parameter.name)[1]}")
    axis.set_xlabel(labelled(profile.parameter.name))


def curve(profile: Profile) -> tuple[Array, Array]:
    """Between the values that were looked at: straight lines in the root of χ², exact of a parabola."""
    parameter = profile.parameter
    inner = np.array([parameter.inner(float(value)) for value in profile.value])
    best = parameter.inner(profile.estimate)
    root = np.sign(inner - best) * np.sqrt(np.maximum(profile.above, 0.0))
    fine = np.linspace(inner[0], inner[-1], 200)
    return np.array([parameter.outer(float(x)) for x in fine]), np.interp(fine, inner, root) ** 2
