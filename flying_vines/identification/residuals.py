"""What is left after a fit: is it noise, and if not, what does it depend on?

Residuals of a simulation that lacks something are alike from sample to sample, and small where their sign
changes; their sum of squares alone says little. So they are looked at in groups of samples that have
something in common (a stretch of time, a time since a valve turned, a pressure, an opening): of noise alone
the mean of n residuals has the variance 1/n, and the sum of n·mean² over g groups is χ² with g degrees of
freedom. A regulator acts on what it reads: a low reading opens a valve. So a sample is put into its group by
what the valves did before it, not by what they did because of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import log

import numpy as np
from scipy import stats

from flying_vines.identification.fit import Fit, FitProblem
from flying_vines.physics.arrays import Array

CHANNELS = ("control volume", "reservoir")
STRETCHES_S = (0.1, 0.5, 2.5, 10.0)
SINCE_S = (0.0, 0.025, 0.05, 0.08, 0.15, 0.3, 0.7, 1.5, 5.0, np.inf)
FEWEST = 4
"""Samples in a group."""
CLASSES = 8
LN10 = log(10.0)


@dataclass(frozen=True)
class Pattern:
    """What the residuals of one channel do with one thing that they may depend on."""

    channel: str
    feature: str
    unit: str
    centre: Array
    """(groups,) of the feature."""
    mean: Array
    """(groups,) residual in units of noise."""
    count: Array
    surprise: float
    """−log₁₀ of how often noise alone makes means as large as these."""


def patterns(problem: FitProblem, fit: Fit) -> list[Pattern]:
    """All that are looked for, the strongest first."""
    found = []
    for row, channel in enumerate(CHANNELS):
        residual = np.concatenate([r[row] for r in fit.residuals])
        measured = np.concatenate([w[row] > 0.0 for w in problem.weights])
        if np.count_nonzero(measured) < 2 * FEWEST:
            continue
        for feature, unit, value, group in _features(problem, fit):
            pattern = _pattern(channel, feature, unit, residual, value, np.where(measured, group, -1))
            if pattern is not None:
                found.append(pattern)
    return sorted(found, key=lambda pattern: -pattern.surprise)


def _pattern(
    channel: str, feature: str, unit: str, residual: Array, value: Array, group: Array
) -> Pattern | None:
    kept = group >= 0
    _, index = np.unique(group[kept], return_inverse=True)
    count = np.bincount(index).astype(float)
    enough = count >= FEWEST
    if np.count_nonzero(enough) < 1:
        return None
    mean = np.bincount(index, residual[kept])[enough] / count[enough]
    centre = np.bincount(index, value[kept])[enough] / count[enough]
    count = count[enough]
    surprise = -float(stats.chi2.logsf(float(count @ mean**2), len(count))) / LN10
    return Pattern(channel, feature, unit, centre, mean, count, surprise)


def _features(problem: FitProblem, fit: Fit) -> Iterator[tuple[str, str, Array, Array]]:
    """Each: its name and unit, its value and its group (negative: none), over all samples of all runs."""
    case = problem.case
    times = [run.time_s - run.time_s[0] for run in case.runs]
    since_start = np.concatenate(times)
    offsets = np.repeat(np.arange(len(times)) * 10_000_000, [len(t) for t in times])
    for stretch_s in STRETCHES_S:
        yield f"time in stretches of {stretch_s:g} s", "s", since_start, offsets + (since_start // stretch_s)
    for name in ("evp_opening", "dvp_opening", "solenoid"):
        label = {"evp_opening": "inflation valve", "dvp_opening": "Venturi's valve"}.get(name, name)
        for what, sign in (("opened", 1.0), ("closed", -1.0)):
            since = np.concatenate(
                [_since(t, getattr(run, name), sign) for t, run in zip(times, case.runs, strict=True)]
            )
            group = np.digitize(since, SINCE_S) - 1.0
            yield f"time since the {label} {what}", "s", since, np.where(np.isfinite(since), group, -1.0)
    evp = np.concatenate([_before(run.evp_opening) for run in case.runs])
    yield "opening of the inflation valve", "", evp, _classes(evp)
    if all(run.ambient_C is not None for run in case.runs):
        ambient_C = np.concatenate([run.ambient_C for run in case.runs if run.ambient_C is not None])
        yield "temperature around", "°C", ambient_C, _classes(ambient_C)
    # As simulated: what was measured shares its noise with the residual.
    simulated = problem.simulated(fit.point)
    for row, label in enumerate(("control volume's pressure", "reservoir's pressure")):
        value = np.concatenate([pressures[row] for pressures in simulated])
        yield label, "kPa", value, _classes(value)
    slopes = [
        np.diff(p[0], prepend=p[0, :1]) / np.diff(t, prepend=-1.0)
        for p, t in zip(simulated, times, strict=True)
    ]
    slope = np.concatenate(slopes)
    yield "rate of the control volume's pressure", "kPa/s", slope, _classes(slope)


def _classes(value: Array) -> Array:
    """Groups of about equally many samples."""
    edges = np.unique(np.quantile(value, np.linspace(0.0, 1.0, CLASSES + 1)[1:-1]))
    return np.digitize(value, edges).astype(float)


def _before(value: Array) -> Array:
    """What held until each sample."""
    return np.concatenate((value[:1], value[:-1]))


def _since(time_s: Array, value: Array, sign: float) -> Array:
    """Seconds since a valve was last told to move this way, before this sample; infinite if never."""
    moved = np.flatnonzero(sign * np.diff(value) > 1e-9) + 1
    last = np.searchsorted(moved, np.arange(len(time_s)), side="left") - 1
    since = np.full(len(time_s), np.inf)
    known = last >= 0
    since[known] = time_s[known] - time_s[moved[last[known]]]
    return since
