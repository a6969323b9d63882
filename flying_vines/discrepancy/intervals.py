"""How well the data fix a parameter: the profile of χ², all else refitted.

The 95 % interval is where χ² (with what is believed) lies less than 3.84 above its least (Wilks 1938). The
curvature at the least says where to look; where the profile is no parabola, the interval is not symmetric.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

import numpy as np

from flying_vines.discrepancy.cause import Parameter
from flying_vines.discrepancy.model import Array
from flying_vines.discrepancy.search import Candidate

ABOVE = 3.84
NEAR_ENOUGH = 0.25
MOST_FITS = 5
STEPS = 6


@dataclass(frozen=True)
class Profile:
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


def profile(candidate: Candidate, index: int, number: int) -> Profile:
    """Of the parameter `number` of the cause `index`."""
    problem, point = candidate.problem, candidate.fit.point
    cause = point.causes[index]
    parameter, best = cause.parameters[number], point.values[index][number]
    at = len(point.deviation) + sum(len(c.parameters) for c in point.causes[:index]) + number
    sd = float(np.sqrt(candidate.covariance[at, at]))
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
    return Profile(
        cause.name, parameter, best, low, high, np.array(values), np.array([seen[v] for v in values])
    )


def _crossing(above: Callable[[float], float], best: float, step: float, bound: float) -> float:
    """Where a profile that is nearly a parabola comes to `ABOVE`, or its bound if that is nearer."""
    for _ in range(MOST_FITS):
        where = best + step
        if (where >= bound) if step > 0.0 else (where <= bound):
            where, step = bound, bound - best
        height = above(where)
        if abs(height / ABOVE - 1.0) < NEAR_ENOUGH or (where == bound and height < ABOVE):
            break
        step *= min(3.0, max(0.3, sqrt(ABOVE / max(height, 1e-3))))
    return where if where == bound else best + step * min(1.5, sqrt(ABOVE / max(height, 1e-3)))
