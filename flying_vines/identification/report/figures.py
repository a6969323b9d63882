"""The figures of a verdict, by name, for a report or a notebook."""

from __future__ import annotations

from math import isfinite
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.cluster.hierarchy import leaves_list, linkage
from scipy.spatial.distance import squareform

from flying_vines.identification.candidate import CLAIM
from flying_vines.identification.evidence import Similarity
from flying_vines.identification.intervals import ABOVE, LikelihoodProfile
from flying_vines.identification.report.readings import (
    AFTER,
    BEFORE,
    INK,
    blank,
    channels,
    draw_autocorrelation,
    draw_dependence,
    draw_residuals,
    draw_run,
    model_difference,
    models,
    quiet,
    strongest,
    typeset,
)
from flying_vines.identification.show import label_and_unit, labelled, numbers, share
from flying_vines.identification.verdict import ParameterEstimate, Tried, Verdict
from flying_vines.physics.arrays import Array
from flying_vines.plots.style import GREY, PURPLE

MAX_RUNS = 6
MAX_RANKED = 16
_LABEL = 48
"""Characters in a line of a candidate's label."""
SEEN = 5.0
"""A trace shorter than this many standard deviations has no reliable direction."""
ALIKE = 0.95
_WRITTEN = 0.5
_DARK = 0.7
_MAX_ACROSS = 3
_HIGHEST = 1.6 * ABOVE
_LARGE = 1e6
"""Ticks from this value on have an exponent."""


def figures(verdict: Verdict) -> dict[str, Figure]:
    """All figures of a verdict, in the order of the report.

    Args:
        verdict: of `diagnose`; all arrays are in `verdict.evidence`.

    Returns:
        by name: `unseen`, `run-1`… (of `verdict.evidence.runs`, counted from 1), `residuals`,
        `autocorrelation`, `dependence`, `ranking`, `profiles` (only if the best fit has a cause) and
        `likeness`. Gauge pressures in kPa, residuals in standard deviations of the noise. The figures belong
        to no window and need not be closed: `figure.savefig("run.pdf")`.
    """
    evidence = verdict.evidence
    model = models(verdict)
    with typeset():
        drawn = {"unseen": draw_unseen(verdict)}
        for index in shown_runs(verdict):
            drawn[f"run-{index + 1}"] = draw_run(evidence.runs[index], evidence.noise_kPa, model)
        if channels(verdict):
            drawn["residuals"] = draw_residuals(verdict)
            drawn["autocorrelation"] = draw_autocorrelation(verdict)
        if strongest(verdict):
            drawn["dependence"] = draw_dependence(verdict)
        drawn["ranking"] = draw_ranking(verdict)
        if evidence.profiles:
            drawn["profiles"] = draw_profiles(verdict)
        if len(by_similarity(evidence.similarity)) > 1:
            drawn["likeness"] = draw_similarity(verdict)
    return drawn


def shown_runs(verdict: Verdict) -> list[int]:
    """Indices of the runs to draw; of many runs, those in which the simulations differ most."""
    evidence = verdict.evidence
    model = models(verdict)
    squares = [float(np.mean(model_difference(run, evidence.noise_kPa, model) ** 2)) for run in evidence.runs]
    return sorted(sorted(range(len(squares)), key=lambda i: -squares[i])[:MAX_RUNS])


def draw_unseen(verdict: Verdict) -> Figure:
    """Root mean square error relative to the measured range: before, after, and from noise alone."""
    errors = verdict.held_out
    bars = [("baseline", errors.nrmse_before, BEFORE)]
    if models(verdict):
        bars.append(("extended", errors.nrmse_after, AFTER))
    bars.append(("noise alone", errors.noise_floor, GREY))
    figure = blank(0.5 + 0.28 * len(bars))
    axis = figure.subplots()
    longest = max(value for _, value, _ in bars)
    for y, (_, value, color) in enumerate(bars):
        axis.barh(y, 100.0 * value, height=0.62, color=color)
        axis.annotate(
            share(value), (100.0 * value, y), (5, 0), textcoords="offset points", va="center", color=INK
        )
    axis.axvline(100.0 * errors.noise_floor, color=GREY, lw=0.8, ls=(0, (3, 3)))
    axis.set_yticks(range(len(bars)), [label for label, _, _ in bars])
    axis.set_ylim(len(bars) - 0.5, -0.5)
    axis.set_xlim(0.0, 115.0 * longest if longest > 0.0 else 1.0)
    axis.set_xlabel("error on unseen data, % of the measured range")
    quiet(axis)
    axis.grid(axis="y", visible=False)
    return figure


def _ranked(verdict: Verdict) -> list[Tried]:
    """The best candidates, and the baseline whatever its rank is."""
    fitted = [tried for tried in verdict.ranking if isfinite(tried.score)]
    return fitted[:MAX_RANKED] + [tried for tried in fitted[MAX_RANKED:] if not tried.causes]


def _color(tried: Tried, verdict: Verdict) -> str:
    """The colour of a candidate, by its role in the verdict."""
    if not tried.causes:
        return BEFORE
    named = {named.cause for named in verdict.named}
    if set(tried.causes) == named:
        return AFTER
    # Purple: the candidate replaces exactly one named cause by an indistinguishable cause.
    others = set(tried.causes) - named
    alike = len(others) == 1 and others <= set(verdict.indistinguishable)
    return PURPLE if alike and len(tried.causes) == len(named) else GREY


def draw_ranking(verdict: Verdict) -> Figure:
    """How far the log evidence of each candidate is below the best."""
    rows = _ranked(verdict)
    labels = [fill(" + ".join(tried.causes), _LABEL, break_long_words=False) or "baseline" for tried in rows]
    lines = max(label.count("\n") + 1 for label in labels)
    figure = blank(0.75 + (0.07 + 0.13 * lines) * len(rows))
    axis = figure.subplots()
    behind = np.array([0.5 * tried.score for tried in rows])
    for y, (tried, x) in enumerate(zip(rows, behind, strict=True)):
        color = _color(tried, verdict)
        axis.plot([0.0, x], [y, y], color=color, lw=1.4, alpha=0.45, solid_capstyle="butt")
        axis.plot(x, y, "o", ms=5, color=color, mfc="white" if tried.on_bound else color, mew=1.2)
        if tried.unseen_nrmse is not None:
            style: dict[str, Any] = {"textcoords": "offset points", "va": "center", "annotation_clip": False}
            axis.annotate(
                f"unseen {share(tried.unseen_nrmse)}", (x, y), (7, 0), fontsize=7.5, color=INK, **style
            )
    axis.set_xscale("symlog", linthresh=10.0, linscale=0.8)
    axis.set_xlim(-0.5, max(100.0, 200.0 * behind.max(initial=0.0)))
    axis.axvspan(-0.5, 0.5 * CLAIM, color=INK, alpha=0.07, lw=0)
    axis.set_yticks(range(len(rows)), labels)
    axis.set_ylim(len(rows) - 0.4, -0.6)
    axis.set_xlabel("ln evidence behind the best")
    quiet(axis)
    axis.grid(axis="y", visible=False)
    return figure


def draw_profiles(verdict: Verdict) -> Figure:
    """χ² above its minimum over each parameter of the best fit, others refitted; with 95 % intervals."""
    profiles = verdict.evidence.profiles
    across = min(_MAX_ACROSS, max(2, len(profiles)))
    down = -(-len(profiles) // across)
    figure = blank(2.3 * down)
    axes = figure.subplots(down, across, squeeze=False)
    for axis in axes.flat[len(profiles) :]:
        axis.set_axis_off()
    for profile, axis in zip(profiles, axes.flat, strict=False):
        _profile(axis, profile)
    for row in axes:
        row[0].set_ylabel("χ² above minimum")
    return figure


def _profile(axis: Any, profile: LikelihoodProfile) -> None:
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
    if profile.high >= _LARGE:
        axis.locator_params(axis="x", nbins=3)
        axis.xaxis.set_major_formatter("{x:.3g}")
    estimate, low, high = numbers(ParameterEstimate(profile.estimate, profile.low, profile.high))
    unit = label_and_unit(profile.parameter.name)[1]
    quiet(axis, f"{profile.cause}\n{estimate} {unit}\n({low} … {high})")
    axis.set_xlabel(labelled(profile.parameter.name))


def curve(profile: LikelihoodProfile) -> tuple[Array, Array]:
    """The likelihood profile as a curve, linear in the square root of χ², which is exact for a parabola."""
    parameter = profile.parameter
    searched = np.array([parameter.to_search(float(value)) for value in profile.value])
    best = parameter.to_search(profile.estimate)
    root = np.sign(searched - best) * np.sqrt(np.maximum(profile.above, 0.0))
    fine = np.union1d(np.linspace(searched[0], searched[-1], 200), searched)
    return np.array([parameter.to_model(float(x)) for x in fine]), np.interp(fine, searched, root) ** 2


def draw_similarity(verdict: Verdict) -> Figure:
    """Cosine similarity of the traces of each pair of visible causes, and how clearly each cause shows."""
    similarity = verdict.evidence.similarity
    order = by_similarity(similarity)
    count = len(order)
    names = [similarity.causes[i] for i in order]
    figure = blank(1.6 + 0.2 * count)
    matrix, bars = figure.subplots(1, 2, width_ratios=[5.0, 1.0])
    matrix.imshow(similarity.cosine[np.ix_(order, order)], cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for y, i in enumerate(order):
        for x, j in enumerate(order):
            if x != y and similarity.cosine[i, j] >= _WRITTEN:
                color = "white" if similarity.cosine[i, j] > _DARK else "black"
                percent = f"{100.0 * similarity.cosine[i, j]:.0f}"
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
    bars.barh(range(count), similarity.seen[order], color=GREY, height=0.7, log=True)
    bars.set_xlim(left=1.0)
    bars.set_ylim(matrix.get_ylim())
    bars.set_yticks([])
    quiet(bars, "shows, σ")
    return figure


def by_similarity(similarity: Similarity) -> NDArray[np.intp]:
    """The causes with a visible trace, ordered so that similar ones are neighbours."""
    seen = np.flatnonzero(similarity.seen >= SEEN)
    if len(seen) < 3:
        return seen
    distance = np.clip(1.0 - similarity.cosine[np.ix_(seen, seen)], 0.0, 1.0)
    np.fill_diagonal(distance, 0.0)
    order: NDArray[np.intp] = leaves_list(
        linkage(squareform(distance, checks=False), "average", optimal_ordering=True)
    )
    return seen[order]


def alike_pairs(similarity: Similarity) -> list[tuple[str, str, float]]:
    """Pairs that these data hardly distinguish, the most similar first."""
    seen = np.flatnonzero(similarity.seen >= SEEN)
    pairs = [
        (similarity.causes[i], similarity.causes[j], float(similarity.cosine[i, j]))
        for place, i in enumerate(seen)
        for j in seen[place + 1 :]
        if similarity.cosine[i, j] >= ALIKE
    ]
    return sorted(pairs, key=lambda pair: -pair[2])
