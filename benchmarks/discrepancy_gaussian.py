"""A Gaussian process for the error of the baseline, after Kennedy & O'Hagan (2001), on rates of change.

The baseline is refitted within its tolerances. The process then learns the remaining error of the rates as a
smooth function of pressures and openings. This method cannot name a cause. Its verdict is `unexplained` if
the process is worth its parameters by BIC, else `none`. As for `diagnose`, each run is predicted from the
others: the baseline is simulated with the process added to its rates.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from math import log
from typing import Any

import numpy as np
from discrepancy_rates import Series, inflation, motive, outlet, per_SL, series
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from threadpoolctl import threadpool_limits

from flying_vines.identification.case import Case, RecordedRun
from flying_vines.identification.fit import FitPoint, FitProblem
from flying_vines.identification.noise import stated_noise
from flying_vines.identification.simulate import rig_number_keys
from flying_vines.identification.verdict import NONE, UNEXPLAINED
from flying_vines.physics.arrays import Array
from flying_vines.physics.baseline import BaselineState, Inputs, step
from flying_vines.physics.rig import Rig, with_numbers

MOST_ROWS = 300
"""Maximum number of rows from which the process of one pressure learns. The time grows with the cube of this
number."""
SHOWN_S = 0.5
"""First part of a predicted run, from which the fit takes the run's initial pressures."""
STEPS = 2
"""Steps of the integrator for each sample."""


class RateError:
    """The error of the baseline's rate of one pressure, as a function of pressures and openings."""

    def __init__(self, inputs: Array, errors: Array, like: RateError | None = None) -> None:
        """`like` gives the kernel's scales; without `like`, the scales are fitted by maximum likelihood."""
        self._middle, self._spread = inputs.mean(axis=0), np.maximum(inputs.std(axis=0), 1e-9)
        self._scale = max(float(errors.std()), 1e-9)
        unknown = ConstantKernel(0.3, (1e-4, 1e3)) * RBF(np.ones(inputs.shape[1]), (0.1, 100.0))
        self._process: Any = GaussianProcessRegressor(
            unknown + WhiteKernel(0.7, (1e-4, 2.0)) if like is None else like.kernel,
            optimizer="fmin_l_bfgs_b" if like is None else None,
        )
        with warnings.catch_warnings():
            # sklearn warns if the scale of an input ends at its bound, because the input does not matter.
            warnings.simplefilter("ignore", ConvergenceWarning)
            self._process.fit((inputs - self._middle) / self._spread, errors / self._scale)

    @property
    def kernel(self) -> Any:
        """The fitted kernel."""
        return self._process.kernel_

    def beats_noise(self, errors: Array) -> bool:
        """True if the process is better than noise alone, by BIC."""
        n, scaled = len(errors), errors / self._scale
        noise_alone = -0.5 * n * (log(2.0 * np.pi * float(np.mean(scaled**2))) + 1.0)
        gained = float(self._process.log_marginal_likelihood_value_) - noise_alone
        return gained > 0.5 * float(self.kernel.n_dims - 1) * log(n)

    def at(self, inputs: Array) -> float:
        kernel = self.kernel.k1
        x = ((inputs - self._middle) / self._spread)[None]
        return self._scale * float((kernel(x, self._process.X_train_) @ self._process.alpha_)[0])


RateErrors = tuple[RateError, RateError]
"""For reservoir and control volume."""


def look(case: Case) -> dict[str, Any]:
    problem = FitProblem(case, stated_noise(case.rig))
    with threadpool_limits(1):
        null = problem.fit(problem.start().freed(rig_number_keys(case.rig))).point
        rows = _rows(problem, null)
        every = [_stack(rows, channel) for channel in (0, 1)]
        fitted = RateError(*every[0]), RateError(*every[1])
        read = np.concatenate([(run.reservoir_kPa, run.cv_kPa) for run in case.runs], axis=1)
        was_read = np.isfinite(read).any(axis=1)
        found = any(
            one.beats_noise(values)
            for one, (_, values), was in zip(fitted, every, was_read, strict=True)
            if was
        )
        said: dict[str, Any] = {"cause": UNEXPLAINED if found else NONE}
        if len(case.runs) > 1:
            said["held_out"] = _held_out(problem, null, fitted if found else None)
    return said


def _rows(problem: FitProblem, point: FitPoint) -> list[tuple[Array, Array]]:
    """For each run: inputs (rows, 5), and the error of the baseline's rates (rows, 2)."""
    rig = _rig(problem, point)
    return [_rate_errors(problem.case, rig, s) for s in series(problem, point)]


def _rig(problem: FitProblem, point: FitPoint) -> Rig:
    """The rig with its fitted numbers."""
    return with_numbers(problem.case.rig, problem.moved(point))


def _rate_errors(case: Case, rig: Rig, s: Series) -> tuple[Array, Array]:
    reservoir_per_SL, cv_per_SL = per_SL(replace(case, rig=rig))
    into = inflation(rig, s)
    modelled = (
        -reservoir_per_SL * (into + motive(rig, s)),
        cv_per_SL * (into - outlet(rig, s)),
    )
    errors = [s.gain(pressure) - s.mean(rate) for pressure, rate in zip(s.read_kPa, modelled, strict=True)]
    inputs = [s.mean(values) for values in (s.reservoir_kPa, s.cv_kPa, s.evp, s.dvp, s.solenoid)]
    return np.stack(inputs, axis=1), np.stack(errors, axis=1)


def _stack(rows: Sequence[tuple[Array, Array]], channel: int) -> tuple[Array, Array]:
    """The rows of some runs, at most `MOST_ROWS`, evenly from all of them."""
    inputs = np.concatenate([one for one, _ in rows])
    errors = np.concatenate([one[:, channel] for _, one in rows])
    taken = np.unique(np.linspace(0, len(errors) - 1, MOST_ROWS).astype(int))
    return inputs[taken], errors[taken]


def _held_out(problem: FitProblem, null: FitPoint, fitted: RateErrors | None) -> dict[str, float]:
    """Errors on unseen data, divided by the measured range, without and with the process.

    Both channels have the same weight. If `fitted` is None, both errors are without the process.
    """
    case = problem.case
    squares: list[list[Array]] = [[], []]
    for i, run in enumerate(case.runs):
        beginning = run.time_s - run.time_s[0] < SHOWN_S
        used = [np.ones(len(other.time_s), dtype=np.bool_) for other in case.runs]
        used[i] = beginning
        point = FitProblem(case, problem.noise, used).fit(null).point
        baseline = with_it = problem.simulated(point, [i])[0]
        if fitted is not None:
            others = [row for k, row in enumerate(_rows(problem, point)) if k != i]
            learned = RateError(*_stack(others, 0), fitted[0]), RateError(*_stack(others, 1), fitted[1])
            start = BaselineState(*point.initial[problem.starts[i]][0].tolist())
            with_it = _simulated(_rig(problem, point), run, start, learned)
        read = np.stack((run.cv_kPa, run.reservoir_kPa))
        for found, simulated in zip(squares, (baseline, with_it), strict=True):
            found.append(((read - simulated) ** 2)[:, ~beginning])
    before, after = (np.concatenate(one, axis=1) for one in squares)
    read = np.concatenate([np.stack((run.cv_kPa, run.reservoir_kPa)) for run in case.runs], axis=1)
    noise = np.array(problem.noise_kPa)[:, None] ** 2 * np.ones_like(before)
    return {
        "nrmse_before": _nrmse(before, read),
        "nrmse_after": _nrmse(after, read),
        "noise_floor": _nrmse(noise, read),
    }


def _simulated(rig: Rig, run: RecordedRun, start: BaselineState, learned: RateErrors) -> Array:
    """(2, n) control volume and reservoir: steps of the baseline, with the learned rates added."""
    found = np.empty((2, len(run.time_s)))
    state = start
    lengths_s = np.diff(run.time_s, append=run.time_s[-1])
    for k, dt_s in enumerate(lengths_s.tolist()):
        found[:, k] = state.cv_kPa, state.reservoir_kPa
        inputs = Inputs(float(run.evp_opening[k]), float(run.dvp_opening[k]), run.solenoid[k] > 0.5)
        features = np.array([state.reservoir_kPa, state.cv_kPa, inputs.evp, inputs.dvp, inputs.solenoid])
        reservoir, cv = (one.at(features) for one in learned)
        for _ in range(STEPS):
            state = step(rig, state, inputs, dt_s / STEPS)
        state = BaselineState(state.reservoir_kPa + dt_s * reservoir, state.cv_kPa + dt_s * cv)
    return found


def _nrmse(squares: Array, read: Array) -> float:
    """Root mean square error, divided by the measured range.

    `squares` (of errors) and `read` are (2, n), with NaN where there is no reading.
    """
    shares = [
        float(np.nanmean(row) / np.ptp(values[np.isfinite(values)]) ** 2)
        for row, values in zip(squares, read, strict=True)
        if np.isfinite(values).any()
    ]
    return float(np.sqrt(np.mean(shares)))
