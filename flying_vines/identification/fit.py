"""Fits the simulation to the readings of all runs at once; the valve inputs are as recorded.

The fit minimises the cost: χ² (the sum of squared residuals in units of the sensors' noise) plus the prior
terms. It moves the shared numbers, which are the same in all runs: the parameters of the causes and the free
rig numbers. It also moves two initial pressures for each run (two more after each gap in its record).

A rig number stays within its tolerance, where its prior is uniform. The cost uses a Gaussian prior of the
same variance, so a number that the data do not determine stays nominal. A parameter with a typical value also
has a Gaussian prior.

Each Levenberg-Marquardt step is solved exactly within the bounds (Stark & Parker 1995). It is corrected for
the curvature of the model (geodesic acceleration, Transtrum & Sethna 2012), because χ² has long, narrow
valleys where two causes resemble each other. The initial pressures have no bounds and may be many: they are
eliminated from the linear system, and corrected after each step. Most simulations serve to compute the
derivatives, so these are used again while the model is nearly linear (chord method, Kelley 1995).

`scipy.optimize.least_squares` in its place took 1.6 times the simulations, and gave a worse verdict on one of
two real recordings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf
from typing import TypeVar

import numpy as np
from scipy.optimize import lsq_linear

from flying_vines.identification.case import Case
from flying_vines.identification.jacobian import Jacobian, RunJacobian, Tangents
from flying_vines.identification.noise import Noise
from flying_vines.identification.simulate import Simulation, prior_std
from flying_vines.physics.arrays import Array, BoolArray
from flying_vines.physics.cause import Cause, Values
from flying_vines.physics.rig import number

T = TypeVar("T")

MAX_STEPS = 30
FIRST_STEPS = 3
"""Steps from each seed, to choose the best one."""
THEN_STEPS = 2
"""Steps from the best seed, to compare causes."""
MAX_SEEDS = 3
"""If there are more seeds, only those with the lowest χ² are used."""
MIN_GAIN, ROUGH_GAIN = 0.02, 0.1
"""Minimum gain of a step. A fit ends before a step that should lower the cost by less than `MIN_GAIN`. It
also ends after a step that has lowered the cost by less than `MIN_GAIN`; if the cost is higher than the
number of readings, this second limit is multiplied by √(cost/readings). Fits that are only compared with each
other use `ROUGH_GAIN` instead."""
DAMPING, HARDER, EASIER = 1e-3, 4.0, 0.1
"""Damping of the first step; factor for the damping after a failed step, and after a good step."""
LEAST_DAMPING = 2.5e-6
"""If a step fails with less damping, the next damping is computed from this value."""
MAX_TRIALS = 12
"""Maximum number of trials of a step."""
PROBE = 0.1
"""Share of a step after which its curvature is measured."""
MAX_STEP_CHANGE = 0.5
"""A step fails if the model's curvature changes it by more than this share: then it is too long."""
SHORTER = 0.3
"""Factor for a step of two initial pressures that increases χ² on their stretch (up to the next start)."""
LINEAR = 0.05
"""The derivatives are used again if the damping of the next step is low, and if the squared difference
between the residuals and their linear prediction is less than this share of the gain."""
NO_EFFECT = 1e-6
"""A number has no effect at a point if, by the derivative, its whole range changes χ² by less than this."""
CORRECTIONS = 2
"""Maximum number of corrections of the initial pressures after a step of the shared numbers."""
_DEVIATION = 1e-5
"""Finite-difference step of a rig number, as a share of it."""
_OF_RANGE = 1e-4
"""Finite-difference step of a parameter, as a share of its range on the search scale."""
_INITIAL_KPA = (0.1, 0.01)
"""Finite-difference steps of the initial pressures of reservoir and control volume."""
MAX_DERIVATIVE = 1e12
"""A larger derivative means that the simulation has diverged."""
UNREAD_RESERVOIR_KPA = 600.0
"""Initial guess if the reservoir was not recorded."""
_READINGS = 3
"""Number of first readings whose mean is the initial guess of a pressure; after a gap it is one reading."""


@dataclass(frozen=True)
class FitPoint:
    """A point in parameter space."""

    causes: tuple[Cause, ...]
    values: tuple[Values, ...]
    """Parameter values of each cause."""
    deviation: dict[str, float]
    """Relative change of each free rig number, by key. All other rig numbers are nominal."""
    initial: Array
    """(starts, 2) gauge pressures of reservoir and control volume, kPa, run by run."""

    def with_cause(self, cause: Cause, values: Values) -> FitPoint:
        """This point with a further cause."""
        return replace(self, causes=(*self.causes, cause), values=(*self.values, values))

    def without(self, index: int) -> FitPoint:
        """This point without one of the causes."""
        causes = self.causes[:index] + self.causes[index + 1 :]
        return replace(self, causes=causes, values=self.values[:index] + self.values[index + 1 :])

    def with_values(self, index: int, values: Values) -> FitPoint:
        """This point with other values of one of the causes."""
        return replace(self, values=_exchanged(self.values, index, values))

    def pinned(self, index: int, number: int, value: float) -> FitPoint:
        """This point, with one parameter of one cause fixed at a value."""
        cause = self.causes[index]
        fixed = replace(cause.parameters[number], low=value, high=value, typical=None)
        cause = replace(cause, parameters=_exchanged(cause.parameters, number, fixed))
        moved = self.with_values(index, _exchanged(self.values[index], number, value))
        return replace(moved, causes=_exchanged(self.causes, index, cause))

    def with_free(self, keys: Sequence[str]) -> FitPoint:
        """This point, with these rig numbers free and no others."""
        return replace(self, deviation={key: self.deviation.get(key, 0.0) for key in keys})


def _exchanged(items: tuple[T, ...], index: int, item: T) -> tuple[T, ...]:
    """The items, with another one at an index."""
    return (*items[:index], item, *items[index + 1 :])


@dataclass(frozen=True)
class Fit:
    """The result of a fit."""

    point: FitPoint
    chi2: float
    """Without the prior terms."""
    cost: float
    """χ² plus the prior terms."""
    residuals: tuple[Array, ...]
    """For each run (2, n), control volume then reservoir: measured minus simulated in units of noise; 0 where
    nothing was measured."""


class FitProblem:
    """A case to be fitted.

    Args:
        noise: the noise of the sensors.
        used: for each run a boolean (n,), the samples that count; default: all.
    """

    def __init__(self, case: Case, noise: Noise, used: Sequence[BoolArray] | None = None) -> None:
        self.case = case
        self.noise = noise
        self.noise_kPa = noise[0].slow_std_kPa, noise[1].slow_std_kPa
        """Residuals are in units of these."""
        self.simulation = Simulation(case)
        self.data = [np.stack((run.cv_kPa, run.reservoir_kPa)) for run in case.runs]
        self.weights = [np.isfinite(data) / np.array(self.noise_kPa)[:, None] for data in self.data]
        if used is not None:
            self.weights = [weight * mask for weight, mask in zip(self.weights, used, strict=True)]
        self.data = [np.nan_to_num(data) for data in self.data]
        ends = np.cumsum([len(run.start) for run in self.simulation.runs])
        self.starts = [
            slice(end - len(run.start), end) for end, run in zip(ends, self.simulation.runs, strict=True)
        ]
        """Rows of each run in `FitPoint.initial`."""
        self._read = self.start().initial
        self.readings = int(sum(np.count_nonzero(weight) for weight in self.weights))

    @property
    def used(self) -> list[BoolArray]:
        """For each run (2, n): the readings that count."""
        return [weight > 0.0 for weight in self.weights]

    def start(self) -> FitPoint:
        """The nominal rig, with the first readings as initial pressures."""
        initial = []
        for data, weight, run in zip(self.data, self.weights, self.simulation.runs, strict=True):
            for i in run.start:
                # A run starts at rest, but after a gap the pressure may be changing.
                few = _READINGS if i == 0 else 1
                reservoir_kPa = _first(data[1, i:], weight[1, i:], few, UNREAD_RESERVOIR_KPA)
                initial.append((reservoir_kPa, _first(data[0, i:], weight[0, i:], few, 0.0)))
        return FitPoint((), (), {}, np.array(initial))

    def prior_std(self, key: str) -> float:
        """See `prior_std`."""
        return prior_std(self.case.rig, key)

    def simulated(self, point: FitPoint, runs: Sequence[int] | None = None) -> list[Array]:
        """Simulated readings of these runs (default: all): (2, n), control volume then reservoir, kPa."""
        moved = self.moved(point)
        causes = list(zip(point.causes, point.values, strict=True))
        every = range(len(self.data)) if runs is None else runs
        return [
            np.stack(self.simulation.readings(i, moved, causes, point.initial[self.starts[i]])) for i in every
        ]

    def residuals(self, point: FitPoint, runs: Sequence[int] | None = None) -> list[Array]:
        """Residuals of these runs (default: all), as in `Fit`."""
        every = range(len(self.data)) if runs is None else runs
        simulated = self.simulated(point, runs)
        with np.errstate(invalid="ignore"):  # The simulation may have diverged.
            return [(self.data[i] - s) * self.weights[i] for i, s in zip(every, simulated, strict=True)]

    def at(self, point: FitPoint) -> Fit:
        """The fit at a point, without a step."""
        space = _Space(self, point)
        residuals = self.residuals(point)
        chi2 = chi2_of(residuals)
        return Fit(point, chi2, chi2 + space.prior(space.to_search(point)), tuple(residuals))

    def moved(self, point: FitPoint) -> dict[str, float]:
        """Fitted values of the free rig numbers, by key."""
        rig = self.case.rig
        return {key: number(rig, key) * (1.0 + deviation) for key, deviation in point.deviation.items()}

    def tangents(self, fit: Fit) -> Tangents:
        """The directions in which this fit can change its residuals."""
        space = _Space(self, fit.point)
        inside = space.inside(space.to_search(fit.point))
        return Tangents(self.jacobian(fit), fit.residuals, inside)

    def jacobian(self, fit: Fit) -> Jacobian:
        """Derivatives of the residuals by everything that is free, at a fit."""
        space = _Space(self, fit.point)
        return space.jacobian(space.to_search(fit.point), fit.residuals)

    def covariance(self, fit: Fit) -> Array:
        """Posterior covariance of deviations and parameters, on the search scale.

        Priors are included, initial pressures are marginalised, bounds are ignored.
        """
        space = _Space(self, fit.point)
        information, _ = space.normal_equations(self.jacobian(fit), space.to_search(fit.point))
        scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
        inverse = np.linalg.pinv(information / np.outer(scale, scale), rcond=1e-12, hermitian=True)
        covariance: Array = inverse / np.outer(scale, scale)
        return covariance

    def first_fit(self, base: FitPoint, cause: Cause) -> Fit:
        """The first steps of a fit with a further cause.

        Some steps from each seed move only the parameters of this cause and the initial pressures. Then some
        steps from the best of these fits move everything.
        """
        starts = [self._with_first_readings(base.with_cause(cause, values)) for values in cause.seeds()]
        nearest = sorted(starts, key=lambda start: start[0])[:MAX_SEEDS]
        alone = (self.fit(start, FIRST_STEPS, moving=len(cause.parameters)) for _, start in nearest)
        return self.fit(min(alone, key=lambda fit: fit.chi2).point, THEN_STEPS)

    def fit(
        self,
        start: FitPoint,
        max_steps: int = MAX_STEPS,
        moving: int | None = None,
        min_gain: float = MIN_GAIN,
        known: Jacobian | None = None,
    ) -> Fit:
        """The local minimum of the cost near `start`.

        Args:
            max_steps: maximum number of steps.
            moving: of the shared numbers, only this many of the last ones are moved; default: all.
            min_gain: see `MIN_GAIN`.
            known: derivatives by the same numbers at a point near `start`.
        """
        space = _Space(self, start, moving)
        descent = _Descent(self, space, space.clipped(space.to_search(start)), min_gain)
        if not np.isfinite(descent.cost):
            return Fit(start, inf, inf, tuple(descent.residuals))
        # Initial pressures are corrected first. Their step is not damped: if it were large, each later step
        # would curve too much.
        initial_only = known or _Space(self, start, moving=0).jacobian(descent.place, descent.residuals)
        descent.move(*descent.corrected(descent.place, descent.residuals, initial_only, MIN_GAIN))
        jacobian = known.at(descent.residuals) if known else None
        for _ in range(max_steps):
            fresh, enough = jacobian is None, min_gain * max(1.0, descent.cost / self.readings) ** 0.5
            jacobian = jacobian or space.jacobian(descent.place, descent.residuals)
            place, cost = descent.place, descent.cost
            if not descent.step(jacobian, enough, MAX_TRIALS if fresh else 1):
                if fresh:
                    break
                jacobian = None
                continue
            gained = cost - descent.cost
            off_linear = jacobian.nonlinearity(descent.place - place, descent.residuals)
            if gained < enough and (fresh or off_linear < min_gain):
                break
            linear = descent.damping <= DAMPING and off_linear < max(min_gain, LINEAR * gained)
            jacobian = jacobian.at(descent.residuals) if linear else None
        chi2 = chi2_of(descent.residuals)
        return Fit(space.to_model(descent.place), chi2, descent.cost, tuple(descent.residuals))

    def _with_first_readings(self, point: FitPoint) -> tuple[float, FitPoint]:
        """χ² and the point, after a reset of initial pressures to the first readings where that lowers χ².

        A fit without the true cause may have distorted the initial pressures.
        """
        there = self.by_start(self.residuals(point))
        read = self.by_start(self.residuals(replace(point, initial=self._read)))
        chi2 = float(np.where(read < there, read, there).sum())
        initial = np.where((read < there)[:, None], self._read, point.initial)
        return chi2 if np.isfinite(chi2) else inf, replace(point, initial=initial)

    def by_start(self, residuals: Sequence[Array]) -> Array:
        """(starts,) χ² of each stretch, which has one pair of initial pressures."""
        runs = zip(residuals, self.simulation.runs, strict=True)
        with np.errstate(over="ignore"):  # The simulation may have diverged.
            return np.concatenate([np.add.reduceat(np.sum(r**2, axis=0), run.start) for r, run in runs])


class _Descent:
    """A fit on its way: the present place, its residuals and cost, and the damping of the next step."""

    def __init__(self, problem: FitProblem, space: _Space, place: Array, min_gain: float) -> None:
        self._problem, self._space, self._min_gain = problem, space, min_gain
        self.damping = DAMPING
        self.move(place, self._residuals(place))

    def move(self, place: Array, residuals: list[Array]) -> None:
        self.place, self.residuals = place, residuals
        self.cost = self._cost(place, residuals)

    def _residuals(self, place: Array) -> list[Array]:
        return self._problem.residuals(self._space.to_model(place))

    def _cost(self, place: Array, residuals: Sequence[Array]) -> float:
        return chi2_of(residuals) + self._space.prior(place)

    def step(self, jacobian: Jacobian, enough: float, trials: int) -> bool:
        """Go to a better place; False if every trial failed.

        The place stays if a step with little damping should lower the cost by less than the minimum gain.
        """
        space, place, damping = self._space, self.place, self.damping
        little_damped = space.best_step(place, jacobian, min(damping, DAMPING))
        if self.cost - space.expected_cost(place, jacobian, little_damped) < self._min_gain:
            self.damping *= EASIER
            return True
        own = self._problem.by_start(self.residuals)
        shares = np.ones(len(own))
        for _ in range(trials):
            straight = space.best_step(place, jacobian, damping)
            step = self._curved(jacobian, straight, damping)
            if step is not None:
                there = space.clipped(place + space.shortened(step, shares))
                there, tried = self.corrected(there, self._residuals(there), jacobian, enough)
                if self._cost(there, tried) <= self.cost:
                    self.move(there, tried)
                    self.damping = damping * EASIER
                    return True
                shares[~(self._problem.by_start(tried) <= own)] *= SHORTER
            damping = HARDER * max(damping, LEAST_DAMPING)
        return False

    def _curved(self, jacobian: Jacobian, straight: Array, damping: float) -> Array | None:
        """The straight step, corrected for the model's curvature; None if that is too large or diverges."""
        if not len(jacobian.reduced):
            return straight
        along = self._space.clipped(self.place + straight) - self.place
        probe = self._residuals(self.place + PROBE * along)
        if not np.isfinite(chi2_of(probe)):
            return None
        curved = self._space.best_step(self.place, jacobian.curved(along, probe, PROBE), damping)
        return curved if jacobian.step_change(straight, curved) <= MAX_STEP_CHANGE else None

    def corrected(
        self, place: Array, residuals: list[Array], jacobian: Jacobian, enough: float
    ) -> tuple[Array, list[Array]]:
        """The place and its residuals, after corrections of the initial pressures that lower χ² of a stretch.

        After a long step of the shared numbers, the best initial pressures differ from the linear prediction.
        """
        problem, space = self._problem, self._space
        for _ in range(CORRECTIONS):
            if not np.isfinite(chi2_of(residuals)):
                break
            step, gain = jacobian.initial_correction(residuals)
            if gain < enough:
                break
            moved = space.with_initial_step(place, step)
            tried = self._residuals(moved)
            better = problem.by_start(tried) < problem.by_start(residuals)
            if not better.any():
                break
            place = np.where(space.of_starts(better), moved, place)
            runs = zip(problem.starts, problem.simulation.runs, tried, residuals, strict=True)
            residuals = [
                np.where(np.repeat(better[starts], np.diff(np.append(run.start, r.shape[1]))), t, r)
                for starts, run, t, r in runs
            ]
        return place, residuals


class _Space:
    """The search space of a fit. A place in it: deviations, parameters, initial pressures run by run."""

    def __init__(self, problem: FitProblem, start: FitPoint, moving: int | None = None) -> None:
        self._problem = problem
        self._start = start
        self._keys = tuple(start.deviation)
        self._parameters = [parameter for cause in start.causes for parameter in cause.parameters]
        self._common = len(self._keys) + len(self._parameters)
        self._starts = problem.starts
        tolerances = [problem.case.rig.tolerance(key) / 100.0 for key in self._keys]
        low = [-t for t in tolerances] + [p.to_search(p.low) for p in self._parameters]
        high = [*tolerances] + [p.to_search(p.high) for p in self._parameters]
        self._nudges = [_DEVIATION] * len(self._keys)
        self._nudges += [_OF_RANGE * p.range for p in self._parameters]
        unbounded = np.full(start.initial.size, np.inf)
        self._low, self._high = np.append(low, -unbounded), np.append(high, unbounded)
        if moving is not None:
            held = self._common - moving
            self._nudges[:held] = [0.0] * held
            self._low[:held] = self._high[:held] = self.to_search(start)[:held]
        typical = [(0.0, problem.prior_std(key)) for key in self._keys]
        typical += [p.typical or (0.0, inf) for p in self._parameters]
        self._typical = np.array([mean for mean, _ in typical])
        self._precision = np.array([sd**-2.0 for _, sd in typical])
        """Inverse prior variances of deviations and parameters; `_typical` are their means."""

    def to_search(self, point: FitPoint) -> Array:
        values = [value for values in point.values for value in values]
        searched = [p.to_search(value) for p, value in zip(self._parameters, values, strict=True)]
        return np.concatenate(([point.deviation[key] for key in self._keys], searched, point.initial.ravel()))

    def to_model(self, place: Array) -> FitPoint:
        keys = len(self._keys)
        searched = iter(place[keys : self._common].tolist())
        return replace(
            self._start,
            values=tuple(
                tuple(p.to_model(next(searched)) for p in cause.parameters) for cause in self._start.causes
            ),
            deviation=dict(zip(self._keys, place[:keys].tolist(), strict=True)),
            initial=place[self._common :].reshape(-1, 2),
        )

    def inside(self, place: Array) -> BoolArray:
        """(numbers,) False where a number that all runs share is on its bound."""
        common = slice(self._common)
        return (place[common] > self._low[common]) & (place[common] < self._high[common])

    def prior(self, place: Array) -> float:
        """The prior term of the cost."""
        return float(self._precision @ (place[: self._common] - self._typical) ** 2)

    def shortened(self, step: Array, shares: Array) -> Array:
        """The step with its initial pressures shortened by these factors, one for each pair."""
        shorter = step.copy()
        shorter[self._common :] *= np.repeat(shares, 2)
        return shorter

    def with_initial_step(self, place: Array, step: Array) -> Array:
        """The place with this step of the initial pressures."""
        there = place.copy()
        there[self._common :] += step
        return there

    def of_starts(self, starts: BoolArray) -> BoolArray:
        """True at the two initial pressures of these starts."""
        return np.concatenate((np.zeros(self._common, dtype=np.bool_), np.repeat(starts, 2)))

    def clipped(self, place: Array) -> Array:
        return np.clip(place, self._low, self._high)

    def jacobian(self, place: Array, residuals: Sequence[Array]) -> Jacobian:
        """The residuals' derivatives."""
        columns = [self._columns(place, residuals, k) for k in range(self._common)]
        runs = []
        for run, starts in enumerate(self._starts):
            initial = []
            for column, nudge in enumerate(_INITIAL_KPA):
                moved = place.copy()
                moved[self._common + 2 * starts.start + column : self._common + 2 * starts.stop : 2] += nudge
                (there,) = self._problem.residuals(self.to_model(moved), [run])
                initial.append(_derivative(there, residuals[run], nudge))
            common = np.array([column[run] for column in columns]).reshape(-1, *residuals[run].shape)
            begins = self._problem.simulation.runs[run].start
            runs.append(RunJacobian(np.array(initial), residuals[run], common, begins))
        return Jacobian(runs)

    def normal_equations(self, jacobian: Jacobian, place: Array) -> tuple[Array, Array]:
        """JᵀJ and Jᵀr of the numbers that all runs share, with their priors."""
        information, gradient = jacobian.square.copy(), jacobian.reduced @ jacobian.reduced_residuals
        information[np.diag_indices_from(information)] += self._precision
        return information, gradient + self._precision * (place[: self._common] - self._typical)

    def _columns(self, place: Array, residuals: Sequence[Array], k: int) -> list[Array]:
        nudge = self._nudges[k]
        if nudge == 0.0:
            return [np.zeros_like(r) for r in residuals]
        if place[k] + nudge > self._high[k]:
            nudge = -nudge
        moved = place.copy()
        moved[k] += nudge
        there = self._problem.residuals(self.to_model(moved))
        return [_derivative(a, b, nudge) for a, b in zip(there, residuals, strict=True)]

    def expected_cost(self, place: Array, jacobian: Jacobian, step: Array) -> float:
        """The cost after a step, by the derivatives, with the best initial pressures."""
        after = jacobian.linear(step)
        return float(after @ after) + self.prior(place + step)

    def best_step(self, place: Array, jacobian: Jacobian, damping: float) -> Array:
        """The step to the minimum of the quadratic model within the bounds."""
        if not self._common:
            return jacobian.initial_step(np.zeros(0))
        information, gradient = self.normal_equations(jacobian, place)
        scale = np.sqrt(np.maximum(np.diag(information), 1e-12))
        scaled = information / np.outer(scale, scale)
        scaled[np.diag_indices_from(scaled)] += damping + 1e-12
        lower = np.linalg.cholesky(scaled)
        target = np.linalg.solve(lower, -gradient / scale)
        here = place[: self._common]
        bounds = self._low[: self._common], self._high[: self._common]
        # Rounding errors would move a number without an effect here to one of its bounds.
        acts = np.diag(information) * (bounds[1] - bounds[0]) ** 2 > NO_EFFECT
        low, high = (np.where(acts, (bound - here) * scale, 0.0) for bound in bounds)
        solved = lsq_linear(
            lower.T, target, (np.minimum(low, -1e-12), np.maximum(high, 1e-12)), method="bvls"
        )
        step = np.asarray(solved.x / scale)
        return np.concatenate((step, jacobian.initial_step(step)))


def _derivative(there: Array, here: Array, nudge: float) -> Array:
    """A finite difference; 0 where the simulation has diverged."""
    gradient = (there - here) / nudge
    return np.where(np.abs(gradient) < MAX_DERIVATIVE, gradient, 0.0)


def chi2_of(residuals: Sequence[Array]) -> float:
    """The sum of squares; infinite where the simulation has diverged."""
    chi2 = sum(float(np.vdot(r, r)) for r in residuals)
    return chi2 if np.isfinite(chi2) else float("inf")


def _first(data: Array, weight: Array, few: int, guess: float) -> float:
    """The mean of the first readings, or `guess` if there are none."""
    measured = data[weight > 0.0][:few]
    return float(measured.mean()) if len(measured) else guess
