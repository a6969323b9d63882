"""Confidence intervals of parameters, from the likelihood profile: χ² with everything else refitted.

In the 95 % interval the cost (χ² plus priors) is less than 3.84 above its minimum (Wilks 1938). The curvature
at the minimum gives the first guess. The interval is not symmetric if the likelihood profile is no parabola.
If the likelihood profile has a plateau beyond an end, the interval includes the plateau (`_plateau_end`).

Residuals that are more than noise widen the interval: 3.84 is multiplied by a ratio of two variances of the
parameter. The first is computed from the residuals themselves, block by block (White 1982), the second from
the noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import exp, inf, isfinite, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy import special

from flying_vines.identification.candidate import Candidate
from flying_vines.identification.jacobian import Jacobian
from flying_vines.physics.arrays import Array
from flying_vines.physics.cause import Parameter

ABOVE = 3.84
NEAR_ENOUGH = 0.25
MAX_FITS = 8
STEPS = 6
FLAT = 0.01
"""If the rise is below this share of the limit, the next step may be up to 30 times as long, otherwise up to
3 times."""
WALL = 5.0
"""If √rise is more than this many times √limit, the search bisects."""
OF_A_RUN = 10
"""Minimum number of blocks in a run. It is low, so that blocks are long: the misfit of a model is correlated
over a longer time than prediction errors are."""
BLOCK_S = 4.0
MIN_BLOCKS = 25
"""Minimum number of blocks in all runs together: a short recording has shorter blocks. If there were only
ten blocks and the misfit were in two of them, one draw in ten would contain neither."""
BLOCK_SAMPLES = 4
"""Blocks are at least this long, in median sampling intervals."""
PLATEAU = 3.0
"""The likelihood profile has a plateau if, at twice the distance of the interval's end from the estimate, it
is below this many times the limit. A parabola is at four times the limit there."""
EDGE_FITS = 6
"""Number of fits that bracket the far end of a plateau."""
UNLIKELY = 0.025
"""Share of the likelihood outside each end of an interval."""
OF_WIDTH = 0.64
"""For a normal distribution: the integral of the likelihood, divided by its maximum and by the width of the
95 % interval."""
BLIND = 1e-4
"""First step if the curvature is zero, as a share of the parameter's range."""


@dataclass(frozen=True)
class LikelihoodProfile:
    """The likelihood profile of one parameter of a fit, and its 95 % interval."""

    cause: str
    parameter: Parameter
    estimate: float
    low: float
    high: float
    value: Array
    """(n,) rising values at which the likelihood profile was computed."""
    above: Array
    """(n,) rise of the cost above its minimum."""
    limit: float
    """Rise at the ends of the interval."""


def blocks(times_s: Sequence[Array], at_least: int = MIN_BLOCKS) -> list[NDArray[np.intp]]:
    """For each run (n,) the block numbers of its samples.

    All runs together have `at_least` blocks or more, if the readings are dense enough.
    """
    longest_s = min(BLOCK_S, sum(float(time_s[-1] - time_s[0]) for time_s in times_s) / at_least)
    found = []
    for time_s in times_s:
        length_s = max(longest_s, BLOCK_SAMPLES * float(np.median(np.diff(time_s))))
        found.append(((time_s - time_s[0]) // length_s).astype(np.intp))
    return found


def widening(candidate: Candidate, jacobian: Jacobian) -> Array:
    """(numbers,) factor of `ABOVE` for each free rig number and parameter; 1 if the residuals are noise.

    If the residuals have no pattern but are larger than noise, their excess is the factor.
    """
    covariance = candidate.covariance
    if candidate.adequate or not len(covariance):
        return np.full(len(covariance), max(candidate.excess))
    scores = []
    for run, derivatives in zip(candidate.problem.case.runs, jacobian.runs, strict=True):
        block = np.tile(blocks([run.time_s], OF_A_RUN)[0], 2)
        products = derivatives.reduced * derivatives.reduced_residuals
        scores.append(np.stack([np.bincount(block, row) for row in products], axis=1))
    by_block = np.concatenate(scores)
    spread = np.einsum("ij,bj,bk,ki->i", covariance, by_block, by_block, covariance)
    few = special.stdtrit(max(1, len(by_block) - len(covariance)), 0.975) ** 2 / ABOVE
    wider: Array = np.maximum(1.0, few * spread / np.diag(covariance))
    return wider


def profile(
    candidate: Candidate, index: int, number: int, wider: Array, jacobian: Jacobian
) -> LikelihoodProfile:
    """The likelihood profile of the parameter `number` of the cause `index`.

    Args:
        wider: from `widening`.
        jacobian: derivatives at the candidate's fit.
    """
    problem, point = candidate.problem, candidate.fit.point
    cause = point.causes[index]
    parameter, best = cause.parameters[number], point.values[index][number]
    at = candidate.columns(index)[number]
    limit = ABOVE * float(wider[at])
    # The curvature is zero if the parameter changes the data only in jumps.
    sd = float(np.sqrt(candidate.covariance[at, at] * wider[at])) or BLIND * parameter.range
    seen = {best: 0.0}

    def above(x: float) -> float:
        held = problem.fit(point.pinned(index, number, parameter.to_model(x)), STEPS, known=jacobian)
        seen[parameter.to_model(x)] = difference = held.cost + parameter.prior_penalty(x) - least
        return difference

    least = candidate.fit.cost
    centre = parameter.to_search(best)
    bounds = [parameter.to_search(bound) for bound in (parameter.low, parameter.high)]
    ends = [
        _crossing(above, centre, side * 1.96 * sd, bound, limit)
        for side, bound in zip((-1.0, 1.0), bounds, strict=True)
    ]
    low, high = (
        parameter.to_model(_plateau_end(above, centre, end, bound, limit, ends[1] - ends[0]))
        for end, bound in zip(ends, bounds, strict=True)
    )
    values = sorted(seen)
    return LikelihoodProfile(
        cause.name, parameter, best, low, high, np.array(values), np.array([seen[v] for v in values]), limit
    )


def _crossing(
    above: Callable[[float], float], best: float, step: float, bound: float, limit: float = ABOVE
) -> float:
    """The value at which a likelihood profile rises to `limit`, or the bound if that is nearer.

    If the likelihood profile is a parabola, √rise is linear. If not, the crossing is bracketed.
    """
    outward = 1.0 if step > 0.0 else -1.0
    under, under_root = best, 0.0
    over = over_root = inf
    where = best + step
    for _ in range(MAX_FITS):
        where = min(where, bound) if outward > 0.0 else max(where, bound)
        height = above(where)
        if where == bound and height < limit:
            return bound
        if abs(height / limit - 1.0) < NEAR_ENOUGH:
            where = best + (where - best) * sqrt(limit / height)
            break
        root = sqrt(max(height, 0.0))
        if height < limit:
            under, under_root = where, root
        else:
            over, over_root = where, root
        if isfinite(over):
            share = (sqrt(limit) - under_root) / (over_root - under_root)
            where = under + (over - under) * (
                0.5 if over_root > WALL * sqrt(limit) else min(0.9, max(0.1, share))
            )
        else:
            most = 30.0 if height < FLAT * limit else 3.0
            where = best + (under - best) * min(most, max(1.1, sqrt(limit) / max(under_root, 1e-3)))
    else:
        if WALL * sqrt(limit) < over_root < inf:
            where = over  # The crossing is nearer, but the interval must not be too short.
    return min(where, bound) if outward > 0.0 else max(where, bound)


def _plateau_end(
    above: Callable[[float], float], best: float, end: float, bound: float, limit: float, width: float
) -> float:
    """The far end of a plateau of the likelihood profile behind `end`; `end` if there is none that matters.

    A parameter that acts in jumps can have such a plateau. An example is the stall pressure of the Venturi:
    the data only show between which two pressures it is, and noise makes χ² a little lower near one of the
    two. The plateau matters if it has more than 2.5 % of the likelihood. `width` is the width of the interval
    without the plateau.
    """
    height, far, over = inf, end, best + 2.0 * (end - best)
    while end not in (best, bound):
        over = min(over, bound) if end > best else max(over, bound)
        there = above(over)
        if there > PLATEAU * limit:
            break
        height, far, over = min(height, there), over, best + 2.0 * (over - best)
        if far == bound:
            break
    if far == end:
        return end
    for _ in range(EDGE_FITS if far != bound else 0):
        middle = 0.5 * (far + over)
        if above(middle) > PLATEAU * limit:
            over = middle
        else:
            far = middle
    likelihood = exp(-0.5 * ABOVE * height / limit) * abs(far - end)
    return far if likelihood > UNLIKELY * (likelihood + OF_WIDTH * width) else end
