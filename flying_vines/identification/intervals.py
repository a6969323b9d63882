"""How well the data fix a parameter: the profile of χ², all else refitted.

The 95 % interval is where χ² (with what is believed) lies less than 3.84 above its least (Wilks 1938). The
curvature at the least says where to look; where the profile is no parabola, the interval is not symmetric.
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
MOST_FITS = 8
STEPS = 6
FLAT, WALL = 0.04, 10.0
"""A profile that has risen so little says nothing of where it will; one whose root is so high is a wall."""
BLIND = 1e-4
"""Of a parameter's range: where it is looked first if the curvature does not tell."""


@dataclass(frozen=True)
class LikelihoodProfile:
    """Of one parameter of a fit."""

    cause: str
    parameter: Parameter
    estimate: float
    low: float
    high: float
    value: Array
    """(n,) rising, where it was looked."""
    above: Array
    """(n,) how far χ² is above its least there."""


def profile(candidate: Candidate, index: int, number: int) -> LikelihoodProfile:
    """Of the parameter `number` of the cause `index`."""
    problem, point = candidate.problem, candidate.fit.point
    cause = point.causes[index]
    parameter, best = cause.parameters[number], point.values[index][number]
    at = len(point.deviation) + sum(len(c.parameters) for c in point.causes[:index]) + number
    # Where only jumps move the data, the curvature says nothing.
    sd = float(np.sqrt(candidate.covariance[at, at])) or BLIND * parameter.range
    seen = {best: 0.0}

    def above(inner: float) -> float:
        held = problem.fit(point.pinned(index, number, parameter.outer(inner)), STEPS)
        seen[parameter.outer(inner)] = difference = held.cost + parameter.surprise(inner) - least
        return difference

    least = candidate.fit.cost
    low, high = (
        parameter.outer(_crossing(above, parameter.inner(best), side * 1.96 * sd, parameter.inner(bound)))
        for side, bound in ((-1.0, parameter.low), (1.0, parameter.high))
    )
    values = sorted(seen)
    return LikelihoodProfile(
        cause.name, parameter, best, low, high, np.array(values), np.array([seen[v] for v in values])
    )


def _crossing(above: Callable[[float], float], best: float, step: float, bound: float) -> float:
    """Where a profile comes to `ABOVE`, or its bound if that is nearer.

    √χ² rises straight from the best where the profile is a parabola; where it is none, the crossing is closed
    in on from both sides.
    """
    outward = 1.0 if step > 0.0 else -1.0
    under, under_root = best, 0.0
    over = over_root = inf
    where = best + step
    for _ in range(MOST_FITS):
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
