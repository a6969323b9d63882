"""Tests whether the residuals of a fit are noise. If not, finds the quantity on which they depend.

If the model lacks an effect, successive residuals are correlated, and their sum of squares alone does not
show that. So samples are put into groups by one feature: an interval of time, the time since a valve moved, a
pressure, an opening. With noise alone, the mean of n residuals has the variance 1/n. Rounding to steps q adds
(q²/12)/(1 + c) if the rounded reading changes c times in the group: a constant rounding error does not
average out. The sum of mean²/variance over g groups is χ² with g degrees of freedom.

A low reading makes the regulator open a valve. So the feature of a sample only uses valve movements before
it: a movement that the sample's own noise has caused would make noise look like an effect.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import log

import numpy as np
from scipy import special

from flying_vines.identification.fit import Fit, FitProblem
from flying_vines.physics.arrays import Array, BoolArray

CHANNELS = ("control volume", "reservoir")
STRETCHES_S = (0.1, 0.5, 2.5, 10.0)
STRETCH_SAMPLES = 8
"""For loggers that read only every few seconds: stretches of this many samples are also used, if they are
longer than those of `STRETCHES_S`."""
SINCE_S = (0.0, 0.025, 0.05, 0.08, 0.15, 0.3, 0.7, 1.5, 5.0, np.inf)
MIN_SAMPLES = 4
"""Minimum samples in a group."""
CLASSES = 8
IN_STRETCHES = "time in stretches of"
LN10 = log(10.0)


@dataclass(frozen=True)
class Pattern:
    """Mean residuals of one channel, grouped by one feature."""

    channel: str
    feature: str
    unit: str
    centre: Array
    """(groups,) mean of the feature."""
    mean: Array
    """(groups,) mean residual in units of noise."""
    count: Array
    """(groups,) number of samples."""
    log_p: float
    """−log₁₀ p: p is the probability that noise alone gives means as large as these."""
    strength: float
    """Mean square of the means, over that of noise alone."""


def patterns(problem: FitProblem, fit: Fit) -> list[Pattern]:
    """Patterns of all channels and features, the strongest first."""
    found = []
    for row, channel in enumerate(CHANNELS):
        residual = np.concatenate([r[row] for r in fit.residuals])
        changes = np.concatenate([np.diff(data[row], prepend=np.nan) != 0.0 for data in problem.data])
        rounding = (problem.noise[row].step_kPa / problem.noise_kPa[row]) ** 2 / 12.0
        measured = np.concatenate([w[row] > 0.0 for w in problem.weights])
        if np.count_nonzero(measured) < 2 * MIN_SAMPLES:
            continue
        for feature, unit, value, group in _features(problem, fit):
            kept = measured & (group >= 0)
            groups = _grouped(residual[kept], value[kept], group[kept], changes[kept], rounding)
            if groups is not None:
                found.append(Pattern(channel, feature, unit, *groups))
    return sorted(found, key=lambda pattern: -pattern.log_p)


def excess(found: Sequence[Pattern]) -> tuple[float, float]:
    """Mean square of the slow residuals over that of noise, at least 1; for control volume and reservoir.

    If it is above 1, a wrong cause can lower χ² this many times as much as with noise alone.
    """
    slow = [pattern for pattern in found if pattern.feature.startswith(IN_STRETCHES)]
    cv, reservoir = (
        max([1.0, *(pattern.strength for pattern in slow if pattern.channel == channel)])
        for channel in CHANNELS
    )
    return cv, reservoir


def _grouped(
    residual: Array, value: Array, group: Array, changes: BoolArray, rounding: float
) -> tuple[Array, Array, Array, float, float] | None:
    """Means of feature and residuals, samples, −log₁₀ p and strength; None if there is no group."""
    _, index = np.unique(group, return_inverse=True)
    count = np.bincount(index).astype(float)
    enough = count >= MIN_SAMPLES
    if np.count_nonzero(enough) < 1:
        return None
    mean = np.bincount(index, residual)[enough] / count[enough]
    centre = np.bincount(index, value)[enough] / count[enough]
    changed = np.bincount(index, changes)[enough]
    count = count[enough]
    squares = float(np.sum(mean**2 / (1.0 / count + rounding / (1.0 + changed))))
    with np.errstate(divide="ignore"):  # p may be too small for a float.
        log_p = -float(np.log(special.chdtrc(len(count), squares))) / LN10
    return centre, mean, count, log_p, squares / len(count)


def _features(problem: FitProblem, fit: Fit) -> Iterator[tuple[str, str, Array, Array]]:
    """Name, unit, value and group (negative: none) of each feature, for all samples of all runs."""
    case = problem.case
    times = [run.time_s - run.time_s[0] for run in case.runs]
    since_start = np.concatenate(times)
    offsets = np.repeat(np.arange(len(times)) * 10_000_000, [len(t) for t in times])
    slow_s = STRETCH_SAMPLES * float(np.median(np.concatenate([np.diff(time_s) for time_s in times])))
    for stretch_s in (*STRETCHES_S, slow_s) if slow_s > STRETCHES_S[-1] else STRETCHES_S:
        yield f"{IN_STRETCHES} {stretch_s:g} s", "s", since_start, offsets + (since_start // stretch_s)
    for label, openings in (
        ("inflation valve", [run.evp_opening for run in case.runs]),
        ("Venturi's valve", [run.dvp_opening for run in case.runs]),
        ("solenoid", [run.solenoid for run in case.runs]),
    ):
        for what, sign in (("opened", 1.0), ("closed", -1.0)):
            since = np.concatenate([_since(t, u, sign) for t, u in zip(times, openings, strict=True)])
            group = np.digitize(since, SINCE_S) - 1.0
            yield f"time since the {label} {what}", "s", since, np.where(np.isfinite(since), group, -1.0)
    evp = np.concatenate([_before(run.evp_opening) for run in case.runs])
    yield "opening of the inflation valve", "", evp, _classes(evp)
    if all(run.ambient_C is not None for run in case.runs):
        ambient_C = np.concatenate([run.ambient_C for run in case.runs if run.ambient_C is not None])
        yield "ambient temperature", "°C", ambient_C, _classes(ambient_C)
    # Simulated, because a measured pressure has the same noise as the residual.
    simulated = problem.simulated(fit.point)
    for row, label in enumerate(("control volume's pressure", "reservoir's pressure")):
        value = np.concatenate([pressures[row] for pressures in simulated])
        yield label, "kPa", value, _classes(value)
    runs = zip(simulated, times, strict=True)
    slope = np.concatenate([np.diff(p[0], prepend=p[0, :1]) / np.diff(t, prepend=-1.0) for p, t in runs])
    yield "rate of the control volume's pressure", "kPa/s", slope, _classes(slope)


def _classes(value: Array) -> Array:
    """Groups of about equal size."""
    edges = np.unique(np.quantile(value, np.linspace(0.0, 1.0, CLASSES + 1)[1:-1]))
    return np.digitize(value, edges).astype(float)


def _before(value: Array) -> Array:
    """The value just before each sample."""
    return np.concatenate((value[:1], value[:-1]))


def _since(time_s: Array, value: Array, sign: float) -> Array:
    """Seconds since the valve's last command in this direction, before this sample; infinite if none."""
    moved = np.flatnonzero(sign * np.diff(value) > 1e-9) + 1
    last = np.searchsorted(moved, np.arange(len(time_s)), side="left") - 1
    since = np.full(len(time_s), np.inf)
    known = last >= 0
    since[known] = time_s[known] - time_s[moved[last[known]]]
    return since
