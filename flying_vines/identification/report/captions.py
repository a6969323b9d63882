"""What each picture shows, and what to see in it."""

from __future__ import annotations

import numpy as np

from flying_vines.identification.intervals import ABOVE
from flying_vines.identification.report.canvas import channels, models, residuals
from flying_vines.identification.report.likeness import ALIKE, SEEN, alike_pairs
from flying_vines.identification.report.words import rounded
from flying_vines.identification.residuals import CHANNELS
from flying_vines.identification.search import CLAIM
from flying_vines.identification.verdict import UNEXPLAINED, Verdict


def unseen(verdict: Verdict) -> str:
    what = "Each model was fitted without the data that it is held against here. "
    if not models(verdict):
        return what + "Where the baseline reaches the dashed line, nothing but noise is left to explain."
    errors = verdict.held_out
    if verdict.cause == UNEXPLAINED:
        times = rounded(errors.nrmse_after / errors.noise_floor)
        return what + f"The best that the catalogue has still errs {times} times as much as noise (dashed)."
    return (
        what
        + "An extended model that ends at the dashed line has learned the rig, and not these data's noise."
    )


def run(verdict: Verdict, number: int) -> str:
    name = verdict.evidence.runs[number - 1].run
    what = (
        f"Run {number}, {name}. Gauge pressures as measured and as simulated, above what the valves were "
        "told. "
    )
    if models(verdict):
        return what + "Right: the shaded stretch, in which baseline and extended model part most."
    return what + "Right: the shaded stretch, in which the baseline is furthest off."


def left(verdict: Verdict) -> str:
    noise = " and ".join(
        f"{CHANNELS[row]} {verdict.evidence.noise_kPa[row]:.3g} kPa" for row in channels(verdict)
    )
    before, after = (chi2_per_reading(verdict, extended) for extended in (False, True))
    falls = (
        f"χ² per reading falls from {rounded(before)} to {rounded(after)}"
        if models(verdict)
        else f"χ² per reading is {rounded(before)}"
    )
    return (
        f"Measured less simulated, in standard deviations of the noise ({noise}), all runs one after the "
        "other. The grey band holds 95 % of noise; beside it the histogram, with the normal distribution as "
        f"a line. {falls}; noise alone makes 1. Mind the scales: they differ."
    )


def autocorrelation(verdict: Verdict) -> str:
    return (
        "Are residuals alike that lie so many samples apart? Of noise alone 95 in 100 points lie in the "
        "grey band. A simulation that lacks something errs the same way for many samples in a row."
    )


def dependence(verdict: Verdict) -> str:
    if verdict.cause == UNEXPLAINED:
        return (
            "What is left, sorted by what it depends on most. This is where to look for a cause that nobody "
            "has named."
        )
    told = "the extended model lies on it" if models(verdict) else "the baseline lies on it"
    return (
        "Mean residual of samples that have something in common, with twice its standard error: the "
        f"fingerprint of what is missing. Noise lies on the zero line; {told} if nothing of this is left."
    )


def ranking(verdict: Verdict) -> str:
    colors = "Orange: the baseline. "
    if verdict.named:
        colors += "Blue: what the verdict names. "
        if verdict.indistinguishable:
            colors += "Purple: what could stand in its place. "
    return (
        "How much less likely each candidate makes these data than the best does, as a natural logarithm "
        f"that already charges for every parameter. {colors}Hollow: a parameter would have to be where no "
        f"rig is. Shaded: {CLAIM / 2.0:g}; by less than that no cause is claimed over the baseline. Beside "
        "the best few: error on unseen data."
    )


def profiles(verdict: Verdict) -> str:
    what = (
        "χ² over each parameter, all else refitted at each point. The 95 % interval (shaded) is where it "
        f"lies less than {ABOVE:g} above its least (dashed). A narrow valley: the data fix the number. "
    )
    if verdict.cause == UNEXPLAINED:
        what += "These intervals hold only if the model is right, and here it is not. "
    return what + "Between points the root of χ² is interpolated."


def likeness(verdict: Verdict) -> str:
    return (
        "What each cause does to the readings of these very runs, compared two by two: 100 % if the one can "
        "stand for the other, nothing if their traces have nothing in common. What initial pressures, and "
        "the believed numbers within their tolerances, could imitate is taken off first. Right: how plainly "
        "each would show, in standard deviations of noise, at a strength at which its fits begin; what is "
        "found as strongly as it is. Dark blocks are families that only another experiment can separate."
    )


def told_apart(verdict: Verdict) -> list[str]:
    """What follows from the likeness, in sentences."""
    likeness = verdict.evidence.likeness
    said = [
        f"{first} and {second} are {100.0 * min(cosine, 0.9999):.4g} % alike."
        for first, second, cosine in alike_pairs(likeness)
    ] or [f"No two causes are more than {100.0 * ALIKE:g} % alike in these data."]
    unseen = [name for name, seen in zip(likeness.causes, likeness.seen, strict=True) if seen < SEEN]
    if unseen:
        said.append(f"Left out, for in these data they would hardly show: {', '.join(unseen)}.")
    return said


def chi2_per_reading(verdict: Verdict, extended: bool) -> float:
    """Of all readings of both channels."""
    squares, readings = 0.0, 0
    for shown in verdict.evidence.runs:
        for row in channels(verdict):
            residual = residuals(shown, row, verdict.evidence.noise_kPa)[extended]
            squares += float(np.nansum(residual**2))
            readings += int(np.isfinite(residual).sum())
    return squares / readings
