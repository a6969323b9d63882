"""Confidence intervals of parameters, from the profile of χ² with everything else refitted.

In the 95 % interval the cost (χ² plus priors) is less than 3.84 above its minimum (Wilks 1938). The curvature
at the minimum gives the first guess. The interval is not symmetric if the profile is not a parabola.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, isfinite, sqrt

import numpy as np

from flying_vines.identification.search import Candidate
from flying_vines.physics.arrays import Array
from flying_vines.physics.cause import Parameter

ABOVE = 3.84
NEAR_ENOUGH = 0.25
MAX_FITS = 8
STEPS = 6
FLAT = 0.04
"""From a smaller rise of the profile the crossing cannot be extrapolated."""
WALL = 10.0
"""If the root of the rise is larger, the search bisects."""
BLIND = 1e-4
"""First step if the curvature is zero, as a share of the parameter's range."""


@dataclass(frozen=True)
class LikelihoodProfile:
    """The profile of one parameter of a fit, and its 95 % interval."""

    cause: str
    parameter: Parameter
    estimate: float
    low: float
    high: float
    value: Array
    """(n,) rising values at which the profile was computed."""
    above: Array
    """(n,) rise of the cost above its minimum."""


def profile(candidate: Candidate, index: int, number: int) -> LikelihoodProfile:
    """The profile of the parameter `number` of the cause `index`."""
    problem, point = candidate.problem, candidate.fit.point
    cause = point.causes[index]
    parameter, best = cause.parameters[number], point.values[index][number]
    at = len(point.deviation) + sum(len(c.parameters) for c in point.causes[:index]) + number
    # The curvature is zero if the parameter only changes the data in jumps.
    sd = float(np.sqrt(candidate.covariance[at, at])) or BLIND * parameter.range
    seen = {best: 0.0}

    def above(x: float) -> float:
        held = problem.fit(point.pinned(index, number, parameter.to_model(x)), STEPS)
        seen[parameter.to_model(x)] = difference = held.cost + parameter.prior_penalty(x) - least
        return difference

    least = candidate.fit.cost
    low, high = (
        parameter.to_model(
            _crossing(above, parameter.to_search(best), side * 1.96 * sd, parameter.to_search(bound))
        )
        for side, bound in ((-1.0, parameter.low), (1.0, parameter.high))
    )
    values = sorted(seen)
    return LikelihoodProfile(
        cause.name, parameter, best, low, high, np.array(values), np.array([seen[v] for v in values])
    )


def _crossing(above: Callable[[float], float], best: float, step: float, bound: float) -> float:
    """The value at which a profile rises to `ABOVE`, or the bound if that is nearer.

    If the profile is a parabola, √χ² is linear. If not, the crossing is bracketed.
    """
    outward = 1.0 if step > 0.0 else -1.0
    under, under_root = best, 0.0
    over = over_root = inf
    where = best + step
    for _ in range(MAX_FITS):
        where = min(where, bound) if outward > 0.0 else max(where, bound)
        height = above(where)
        if where == bound and height < ABOVE:
            return bound
        if abs(height / ABOVE - 1.0) < NEAR_ENOUGH:
            where = best + (where - best) * sqrt(ABOVE / height)
            break
        root = sqrt(max(height, 0.0))
        if height < ABOVE:
            under, under_root = where, root
        else:
            over, over_root = where, root
        if isfinite(over):
            share = (sqrt(ABOVE) - under_root) / (over_root - under_root)
            where = under + (over - under) * (0.5 if over_root > WALL else min(0.9, max(0.1, share)))
        else:
            most = 30.0 if height < FLAT else 3.0
            where = best + (under - best) * min(most, max(1.1, sqrt(ABOVE) / max(under_root, 1e-3)))
    return min(where, bound) if outward > 0.0 else max(where, bound)
