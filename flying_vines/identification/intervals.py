"""Confidence intervals of parameters, from the likelihood profile: χ² with everything else refitted.

In the 95 % interval the cost (χ² plus priors) is less than 3.84 above its minimum (Wilks 1938). The curvature
at the minimum gives the first guess. The interval is not symmetric if the likelihood profile is no parabola.

Residuals that are more than noise widen the interval. 3.84 is multiplied by a ratio of two variances of the
parameter: from the residuals themselves, block by block (White 1982), over that from noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, isfinite, sqrt

import numpy as np
from scipy import special

from flying_vines.identification.candidate import Candidate
from flying_vines.identification.jacobian import Jacobian
from flying_vines.identification.prediction_error import blocks
from flying_vines.physics.arrays import Array
from flying_vines.physics.cause import Parameter

ABOVE = 3.84
NEAR_ENOUGH = 0.25
MAX_FITS = 8
STEPS = 6
FLAT = 0.01
"""If the rise is below this share of the limit, the next step may be up to 30 times as long, otherwise 3."""
WALL = 5.0
"""If √rise is more than this many times √limit, the search bisects."""
OF_A_RUN = 10
"""Minimum number of blocks in a run. It is low, so that blocks are long: misfit of a model is correlated for
longer than prediction errors."""
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


def widening(candidate: Candidate, jacobian: Jacobian) -> Array:
    """(numbers,) factor of `ABOVE` for each free rig number and parameter; 1 if the residuals are noise.

    If they have no pattern but are larger than noise, their excess is the factor.
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
    # The curvature is zero if the parameter only changes the data in jumps.
    limit = ABOVE * float(wider[at])
    sd = float(np.sqrt(candidate.covariance[at, at] * wider[at])) or BLIND * parameter.range
    seen = {best: 0.0}

    def above(x: float) -> float:
        held = problem.fit(point.pinned(index, number, parameter.to_model(x)), STEPS, known=jacobian)
        seen[parameter.to_model(x)] = difference = held.cost + parameter.prior_penalty(x) - least
        return difference

    least = candidate.fit.cost
    low, high = (
        parameter.to_model(
            _crossing(above, parameter.to_search(best), side * 1.96 * sd, parameter.to_search(bound), limit)
        )
        for side, bound in ((-1.0, parameter.low), (1.0, parameter.high))
    )
    values = sorted(seen)
    return LikelihoodProfile(
        cause.name, parameter, best, low, high, np.array(values), np.array([seen[v] for v in values]), limit
    )


def _crossing(
    above: Callable[[float], float], best: float, step: float, bound: float, limit: float = ABOVE
) -> float:
    """The value at which a likelihood profile rises to `limit`, or the bound if that is nearer.

    If the likelihood profile is a parabola, √χ² is linear. If not, the crossing is bracketed.
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
