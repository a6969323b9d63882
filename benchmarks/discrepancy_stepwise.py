"""Forward selection by BIC: this project's simulation and causes, with textbook statistics.

Nominal numbers count as exact, a run starts at its first readings, and residuals are independent noise of the
stated size. In each step the cause that lowers χ² + k ln n most is added, and all parameters are refitted,
until no cause lowers it.
"""

from __future__ import annotations

from dataclasses import replace
from math import inf, log
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from flying_vines.identification.case import Case
from flying_vines.identification.fit import FitPoint, FitProblem
from flying_vines.identification.noise import stated_noise
from flying_vines.identification.verdict import NONE
from flying_vines.physics.arrays import Array
from flying_vines.physics.cause import Cause, Values
from flying_vines.physics.effects import catalogue

MOST_CAUSES = 8
MOST_STEPS = 12

OF_RANGE = 1e-4
"""Step of a parameter for a derivative, as a share of its range."""
BROKEN = 1e6
"""Residual of a simulation that fails, in units of noise."""


class Fit(NamedTuple):
    point: FitPoint
    chi2: float


def look(case: Case) -> dict[str, Any]:
    problem = FitProblem(case, stated_noise(case.rig))
    with threadpool_limits(1):
        point = _selected(problem)
    names = [cause.name for cause in point.causes]
    if not names:
        return {"cause": NONE}
    return {"cause": names[0], "also": [{"cause": name} for name in names[1:]]}


def _selected(problem: FitProblem) -> FitPoint:
    point = replace(problem.start(), initial=_first_readings(problem))
    best = Fit(point, problem.chi2(point))
    price = log(problem.readings)
    while len(best.point.causes) < MOST_CAUSES:
        others = [cause for cause in catalogue() if cause not in best.point.causes]
        tried = [_fit(problem, _begun(problem, best.point, cause)) for cause in others]
        least = min(tried, key=lambda fit: fit.chi2 + price * _parameters(fit.point))
        if least.chi2 + price * _parameters(least.point) >= best.chi2 + price * _parameters(best.point):
            break
        best = least
    return best.point


def _first_readings(problem: FitProblem) -> Array:
    """Initial pressures of reservoir and control volume for each start; without a reading, the start values
    of `problem`."""
    initial = problem.start().initial.copy()
    for data, weight, run, rows in zip(
        problem.data, problem.weights, problem.simulation.runs, problem.starts, strict=True
    ):
        for row, i in zip(range(rows.start, rows.stop), run.start, strict=True):
            for column, channel in ((0, 1), (1, 0)):
                read = np.flatnonzero(weight[channel, i:] > 0.0)
                if len(read):
                    initial[row, column] = data[channel, i + read[0]]
    return initial


def _begun(problem: FitProblem, point: FitPoint, cause: Cause) -> FitPoint:
    """The point with a further cause, at its best seed."""
    return min((point.with_cause(cause, values) for values in cause.seeds()), key=problem.chi2)


def _parameters(point: FitPoint) -> int:
    return sum(len(cause.parameters) for cause in point.causes)


def _fit(problem: FitProblem, start: FitPoint) -> Fit:
    """Minimise χ² over the parameters only."""
    parameters = [parameter for cause in start.causes for parameter in cause.parameters]
    low = np.array([p.to_search(p.low) for p in parameters])
    high = np.array([p.to_search(p.high) for p in parameters])
    values = [value for values in start.values for value in values]
    searched = np.array([p.to_search(value) for p, value in zip(parameters, values, strict=True)])
    nudges = OF_RANGE * (high - low)

    def point_at(place: Array) -> FitPoint:
        every = iter(p.to_model(x) for p, x in zip(parameters, place.tolist(), strict=True))
        grouped: list[Values] = [tuple(next(every) for _ in cause.parameters) for cause in start.causes]
        return replace(start, values=tuple(grouped))

    def residuals(place: Array) -> Array:
        every = np.concatenate([run.ravel() for run in problem.residuals(point_at(place))])
        clipped: Array = np.clip(np.nan_to_num(every, nan=BROKEN), -BROKEN, BROKEN)
        return clipped

    def jacobian(place: Array) -> Array:
        here = residuals(place)
        columns = []
        for k, nudge in enumerate(nudges):
            moved = place.copy()
            moved[k] += nudge if place[k] + nudge < high[k] else -nudge
            columns.append((residuals(moved) - here) / (moved[k] - place[k]))
        return np.stack(columns, axis=1)

    # The method needs a start strictly within the bounds.
    begin = np.clip(searched, low + nudges, high - nudges)
    found = least_squares(
        residuals, begin, jacobian, (low, high), x_scale="jac", ftol=1e-6, max_nfev=MOST_STEPS
    )
    chi2 = 2.0 * float(found.cost)
    return Fit(point_at(found.x), chi2 if np.isfinite(chi2) else inf)
