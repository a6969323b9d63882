"""Fitting by simulation error: over all runs at once, initial states included, inputs as recorded.

What is minimised is χ², the sum of squared residuals in units of the sensors' noise, over the parameters of
the causes, the believed numbers that are set free, and two initial pressures a run (two more after each gap
in its record). A believed number stays within its tolerance, where all places are equally likely; of that a
Gaussian of the same variance stands in the sum, so that what the data do not say is left where it was
believed; likewise what is typical of a parameter. Each step of Gauss and Newton is solved exactly within the
bounds (Stark & Parker 1995), damped by Levenberg and Marquardt where it would not help; the initial
pressures, which have no bounds and may be many, are eliminated from it, and each goes only as far as its own
stretch of the record gets better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from flying_vines.identification.case import Case
from flying_vines.identification.simulate import Simulation, believed_spread
from flying_vines.identification.slopes import RunSlopes, Slopes
from flying_vines.physics.arrays import Array
from flying_vines.physics.cause import Cause, Values
from flying_vines.physics.rig import number

Bools = NDArray[np.bool_]

MOST_STEPS = 30
FIRST_STEPS, THEN_STEPS = 3, 2
"""That tell which seed leads on, and how far."""
FEW_SEEDS = 3
"""Of more, the nearest."""
ENOUGH = 0.02
"""A step that lowers χ² by less ends the fit."""
LESS_TRUST = 0.3
"""Factor for a step of initial pressures that increases χ² on its own segment."""
_DEVIATION = 1e-5
_OF_RANGE = 1e-4
_INITIAL_KPA = (0.1, 0.01)
"""How far numbers are moved for a derivative: believed ones by this share, parameters by this share of their
range (along the logarithm where that is moved), initial pressures by this."""
STEEPEST = 1e12
"""Steeper is no derivative: a simulation has broken down."""
UNREAD_RESERVOIR_KPA = 600.0
"""Where a fit begins if nobody recorded the reservoir."""
_READINGS = 3
"""The first so many say where a run begins."""


@dataclass(frozen=True)
class FitPoint:
    """Where a fit is. `deviation` of believed numbers, in shares of them, by key; `values` of the causes."""

    causes: tuple[Cause, ...]
    values: tuple[Values, ...]
    deviation: dict[str, float]
    """Its keys are what is free; the rest is as believed."""
    initial: Array
    """(starts, 2) gauge pressures of reservoir and control volume, kPa, run by run."""

    def with_cause(self, cause: Cause, values: Values) -> FitPoint:
        """The same place with another cause, where it begins."""
        return replace(self, causes=(*self.causes, cause), values=(*self.values, values))

    def without(self, index: int) -> FitPoint:
        """The same place without one of the causes."""
        causes, values = list(self.causes), list(self.values)
        del causes[index], values[index]
        return replace(self, causes=tuple(causes), values=tuple(values))

    def pinned(self, index: int, number: int, value: float) -> FitPoint:
        """The same place, with one parameter of one cause held at a value."""
        cause, values = self.causes[index], list(self.values[index])
        values[number] = value
        parameters = list(cause.parameters)
        parameters[number] = replace(parameters[number], low=value, high=value, typical=None)
        causes, every = list(self.causes), list(self.values)
        causes[index], every[index] = replace(cause, parameters=tuple(parameters)), tuple(values)
        return replace(self, causes=tuple(causes), values=tuple(every))

    def freed(self, keys: Sequence[str]) -> FitPoint:
        """The same place, with these believed numbers free and no others."""
        return replace(self, deviation={key: self.deviation.get(key, 0.0) for key in keys})


@dataclass(frozen=True)
class Fit:
    """Where a fit ended."""

    point: FitPoint
    chi2: float
    """Of the residuals alone."""
    cost: float
    """With what is believed."""
    residuals: tuple[Array, ...]
    """A run's: (2, n), control volume then reservoir, measured less simulated in units of noise; 0 where
    nothing was measured."""


class Tangents:
    """Directions in which a fit is free, and what is left of the residuals."""

    def __init__(self, slopes: Slopes, residuals: Sequence[Array]) -> None:
        self._slopes = slopes
        free = slopes.free.T
        scale = np.linalg.norm(free, axis=0)
        self._basis, _ = np.linalg.qr(free / np.where(scale > 0.0, scale, 1.0))
        self._residual = self.beside(residuals)

    def gain(self, trace: Sequence[Array]) -> float:
        """By how much χ² would fall if the residuals could be changed along this trace, too."""
        own = self.beside(trace)
        length = float(own @ own)
        whole = sum(float(np.vdot(t, t)) for t in trace)
        return float(own @ self._residual) ** 2 / length if length > 1e-9 * whole else 0.0

    def beside(self, trace: Sequence[Array]) -> Array:
        """What is left of a trace, (2, n) a run, beside all that the fit can do itself; in one row."""
        left = self._slopes.beside(trace)
        beside: Array = left - self._basis @ (self._basis.T @ left)
        return beside


class FitProblem:
    """A case to be fitted.

    Args:
        case: the data.
        noise_kPa: standard deviations of control volume's and reservoir's readings.
        used: a boolean (n,) for each run: which samples count; all if not given.
    """

    def __init__(
        self, case: Case, noise_kPa: tuple[float, float], used: Sequence[Bools] | None = None
    ) -> None:
        self.case = case
        self.noise_kPa = noise_kPa
        self.simulation = Simulation(case)
        self.data = [np.stack((run.cv_kPa, run.reservoir_kPa)) for run in case.runs]
        self.weights = [np.isfinite(data) / np.array(noise_kPa)[:, None] for data in self.data]
        if used is not None:
            self.weights = [weight * mask for weight, mask in zip(self.weights, used, strict=True)]
        self.data = [np.nan_to_num(data) for data in self.data]
        ends = np.cumsum([len(run.start) for run in self.simulation.runs])
        self.starts = [
            slice(end - len(run.start), end) for end, run in zip(ends, self.simulation.runs, strict=True)
        ]
        """Of each run, in `FitPoint.initial`."""
        self._read = self.start().initial
        self.readings = int(sum(np.count_nonzero(weight) for weight in self.weights))

    def start(self) -> FitPoint:
        """The believed rig, at rest where the first readings are."""
        initial = []
        for data, weight, run in zip(self.data, self.weights, self.simulation.runs, strict=True):
            for i in run.start:
                # A run begins at rest; where it begins again it may be on its way.
                few = _READINGS if i == 0 else 1
                reservoir_kPa = _first(data[1, i:], weight[1, i:], few, UNREAD_RESERVOIR_KPA)
                initial.append((reservoir_kPa, _first(data[0, i:], weight[0, i:], few, 0.0)))
        return FitPoint((), (), {}, np.array(initial))

    def tolerance(self, key: str) -> float:
        """How well a number is believed, as a share."""
        return self.case.rig.tolerance(key) / 100.0

    def spread(self, key: str) -> float:
        """As `believed_spread`."""
        return believed_spread(self.case.rig, key)

    def simulated(self, point: FitPoint, runs: Sequence[int] | None = None) -> list[Array]:
        """Readings of these runs (all if not given): (2, n), control volume then reservoir, kPa."""
        moved = self.moved(point)
        causes = list(zip(point.causes, point.values, strict=True))
        every = range(len(self.data)) if runs is None else runs
        return [
            np.stack(self.simulation.readings(i, moved, causes, point.initial[self.starts[i]])) for i in every
        ]

    def residuals(self, point: FitPoint, runs: Sequence[int] | None = None) -> list[Array]:
        """Of these runs (all if not given), as in `Fit`."""
        every = range(len(self.data)) if runs is None else runs
        simulated = self.simulated(point, runs)
        return [(self.data[i] - s) * self.weights[i] for i, s in zip(every, simulated, strict=True)]

    def chi2(self, point: FitPoint) -> float:
        """The sum of squared residuals at a place."""
        return _chi2(self.residuals(point))

    def moved(self, point: FitPoint) -> dict[str, float]:
        """The believed numbers that are free, by their keys, where the fit has them."""
        rig = self.case.rig
        return {key: number(rig, key) * (1.0 + deviation) for key, deviation in point.deviation.items()}

    def tangents(self, fit: Fit) -> Tangents:
        """What small changes of all that is fitted do to the residuals."""
        return Tangents(self.slopes(fit), fit.residuals)

    def slopes(self, fit: Fit) -> Slopes:
        """The residuals' derivatives by all that is free, at a fit."""
        space = _Space(self, fit.point)
        return space.slopes(space.inner(fit.point), fit.residuals)

    def covariance(self, fit: Fit) -> Array:
        """Of deviations and causes' parameters as the fit moves them, with what is believed of them, the
        initial pressures moved along; where the data say anything, without the bounds."""
        space = _Space(self, fit.point)
        information, _ = space.believed_too(self.slopes(fit), space.inner(fit.point))
        scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
        inverse = np.linalg.pinv(information / np.outer(scale, scale), rcond=1e-12, hermitian=True)
        covariance: Array = inverse / np.outer(scale, scale)
        return covariance

    def begun(self, base: FitPoint, cause: Cause) -> Fit:
        """The first steps of a fit with a further cause: of it alone from each seed, of all from the best."""
        starts = [self._well_begun(base.with_cause(cause, values)) for values in cause.seeds()]
        nearest = sorted(starts, key=lambda start: start[0])[:FEW_SEEDS]
        alone = (self.fit(start, FIRST_STEPS, moving=len(cause.parameters)) for _, start in nearest)
        return self.fit(min(alone, key=lambda fit: fit.chi2).point, THEN_STEPS)

    def fit(self, start: FitPoint, most_steps: int = MOST_STEPS, moving: int | None = None) -> Fit:
        """The least χ² near `start`.

        Args:
            most_steps: after which it ends wherever it is.
            moving: so many of the last parameters are moved, and no others; all that are free unless given.
        """
        space = _Space(self, start, moving)
        place = space.clipped(space.inner(start))
        residuals = self.residuals(space.outer(place))
        cost = _chi2(residuals) + space.believed(place)
        if not np.isfinite(cost):
            return Fit(start, inf, inf, tuple(residuals))
        damping, trust = 1e-7, np.ones(len(start.initial))
        for _ in range(most_steps):
            slopes, own = space.slopes(place, residuals), self._by_start(residuals)
            for _ in range(10):
                move = space.best_move(place, slopes, damping)
                there = space.clipped(place + space.trusted(move, trust))
                point = space.outer(there)
                tried = self.residuals(point)
                lower = _chi2(tried) + space.believed(there)
                if lower <= cost:
                    break
                damping = max(10.0 * damping, 1e-5)
                trust[~(self._by_start(tried) <= own)] *= LESS_TRUST
            else:
                break
            trust = np.minimum(2.0 * trust, 1.0)
            gained, cost = cost - lower, lower
            place, residuals = there, tried
            damping *= 0.1
            if gained < ENOUGH:
                break
        return Fit(space.outer(place), _chi2(residuals), cost, tuple(residuals))

    def _well_begun(self, point: FitPoint) -> tuple[float, FitPoint]:
        """The same place, with each pair of initial pressures as it is or as first read, whichever is nearer:
        where a cause was missing a fit may have moved them far away to do its work. Its χ² is first."""
        there = self._by_start(self.residuals(point))
        read = self._by_start(self.residuals(replace(point, initial=self._read)))
        chi2 = float(np.where(read < there, read, there).sum())
        initial = np.where((read < there)[:, None], self._read, point.initial)
        return chi2 if np.isfinite(chi2) else inf, replace(point, initial=initial)

    def _by_start(self, residuals: Sequence[Array]) -> Array:
        """(starts,) χ² of what each pair of initial pressures bears on."""
        runs = zip(residuals, self.simulation.runs, strict=True)
        return np.concatenate([np.add.reduceat(np.sum(r**2, axis=0), run.start) for r, run in runs])


class _Space:
    """The numbers that a fit moves, in one row: deviations, parameters, initial pressures run by run."""

    def __init__(self, problem: FitProblem, start: FitPoint, moving: int | None = None) -> None:
        self._problem = problem
        self._start = start
        self._keys = tuple(start.deviation)
        self._parameters = [parameter for cause in start.causes for parameter in cause.parameters]
        self._common = len(self._keys) + len(self._parameters)
        self._starts = problem.starts
        tolerances = [problem.tolerance(key) for key in self._keys]
        low = [-t for t in tolerances] + [p.inner(p.low) for p in self._parameters]
        high = [*tolerances] + [p.inner(p.high) for p in self._parameters]
        self._nudges = [_DEVIATION] * len(self._keys)
        self._nudges += [_OF_RANGE * p.range for p in self._parameters]
        unbounded = np.full(start.initial.size, np.inf)
        self._low, self._high = np.append(low, -unbounded), np.append(high, unbounded)
        if moving is not None:
            held = self._common - moving
            self._nudges[:held] = [0.0] * held
            self._low[:held] = self._high[:held] = self.inner(start)[:held]
        typical = [(0.0, problem.spread(key)) for key in self._keys]
        typical += [p.typical or (0.0, inf) for p in self._parameters]
        self._typical = np.array([mean for mean, _ in typical])
        self._sureness = np.array([sd**-2.0 for _, sd in typical])
        """What is believed of deviations and parameters: mean, and one over the variance."""

    def inner(self, point: FitPoint) -> Array:
        values = [value for values in point.values for value in values]
        inner = [p.inner(value) for p, value in zip(self._parameters, values, strict=True)]
        return np.concatenate(([point.deviation[key] for key in self._keys], inner, point.initial.ravel()))

    def outer(self, place: Array) -> FitPoint:
        keys = len(self._keys)
        values = [
            p.outer(x) for p, x in zip(self._parameters, place[keys : self._common].tolist(), strict=True)
        ]
        grouped = []
        for cause in self._start.causes:
            grouped.append(tuple(values[: len(cause.parameters)]))
            del values[: len(cause.parameters)]
        return replace(
            self._start,
            values=tuple(grouped),
            deviation=dict(zip(self._keys, place[:keys].tolist(), strict=True)),
            initial=place[self._common :].reshape(-1, 2),
        )

    def believed(self, place: Array) -> float:
        """What it costs to be elsewhere than believed."""
        return float(self._sureness @ (place[: self._common] - self._typical) ** 2)

    def trusted(self, move: Array, trust: Array) -> Array:
        """A move that goes only this share of its way in each pair of initial pressures."""
        shorter = move.copy()
        shorter[self._common :] *= np.repeat(trust, 2)
        return shorter

    def clipped(self, place: Array) -> Array:
        return np.clip(place, self._low, self._high)

    def slopes(self, place: Array, residuals: Sequence[Array]) -> Slopes:
        """The residuals' derivatives."""
        columns = [self._columns(place, residuals, k) for k in range(self._common)]
        runs = []
        for run, starts in enumerate(self._starts):
            initial = []
            for column, nudge in enumerate(_INITIAL_KPA):
                moved = place.copy()
                moved[self._common + 2 * starts.start + column : self._common + 2 * starts.stop : 2] += nudge
                (there,) = self._problem.residuals(self.outer(moved), [run])
                initial.append(_slope(there, residuals[run], nudge))
            common = [column[run] for column in columns]
            begins = self._problem.simulation.runs[run].start
            runs.append(RunSlopes(np.array(initial), residuals[run], np.array(common), begins))
        return Slopes(runs)

    def believed_too(self, slopes: Slopes, place: Array) -> tuple[Array, Array]:
        """JᵀJ and Jᵀr of what is common to the runs, with what is believed of it."""
        information, slope = slopes.free @ slopes.free.T, slopes.free @ slopes.left
        information[np.diag_indices_from(information)] += self._sureness
        return information, slope + self._sureness * (place[: self._common] - self._typical)

    def _columns(self, place: Array, residuals: Sequence[Array], k: int) -> list[Array]:
        nudge = self._nudges[k]
        if nudge == 0.0:
            return [np.zeros_like(r) for r in residuals]
        if place[k] + nudge > self._high[k]:
            nudge = -nudge
        moved = place.copy()
        moved[k] += nudge
        there = self._problem.residuals(self.outer(moved))
        return [_slope(a, b, nudge) for a, b in zip(there, residuals, strict=True)]

    def best_move(self, place: Array, slopes: Slopes, damping: float) -> Array:
        """The least of the quadratic model within the bounds."""
        if not self._common:
            return slopes.initial_move(np.zeros(0))
        information, slope = self.believed_too(slopes, place)
        scale = np.sqrt(np.maximum(np.diag(information), 1e-12))
        scaled = information / np.outer(scale, scale)
        scaled[np.diag_indices_from(scaled)] += damping + 1e-12
        lower = np.linalg.cholesky(scaled)
        target = np.linalg.solve(lower, -slope / scale)
        here = place[: self._common]
        low, high = (self._low[: self._common] - here) * scale, (self._high[: self._common] - here) * scale
        solved = lsq_linear(
            lower.T, target, (np.minimum(low, -1e-12), np.maximum(high, 1e-12)), method="bvls"
        )
        move = np.asarray(solved.x / scale)
        return np.concatenate((move, slopes.initial_move(move)))


def _slope(there: Array, here: Array, nudge: float) -> Array:
    """A derivative; 0 where a simulation breaks down, for nothing is learned of the way there."""
    slope = (there - here) / nudge
    return np.where(np.abs(slope) < STEEPEST, slope, 0.0)


def _chi2(residuals: Sequence[Array]) -> float:
    chi2 = sum(float(np.vdot(r, r)) for r in residuals)
    return chi2 if np.isfinite(chi2) else float("inf")


def _first(data: Array, weight: Array, few: int, guess: float) -> float:
    """The mean of the first readings, or a guess where there are none."""
    measured = data[weight > 0.0][:few]
    return float(measured.mean()) if len(measured) else guess
