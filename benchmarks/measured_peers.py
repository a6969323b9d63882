"""Other methods than `diagnose` on a measured rig, scored on the same unseen readings.

- An exponential with a constant, fitted to each run from the first change of its input.
- pysindy's sparse regression of dP/dt on products of pressure and input.
- A Gaussian process of dP/dt as a function of pressure and input.

The last two are simulated from the first reading of a run with the run's input. As for `diagnose`, each run
is predicted from the other runs; if there is only one run, every other stretch of it is predicted from the
rest. The exponential has its own parameters for each run, so it always predicts stretches.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from measured_fits import Array, Readings
from numpy.typing import NDArray
from pysindy import PolynomialLibrary
from pysindy.optimizers import STLSQ
from scipy.optimize import least_squares
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from flying_vines.identification.prediction_error import in_odd_stretch

MAX_ROWS = 300
"""Maximum number of rates from which a Gaussian process learns. The time grows with the cube of this
number."""
WINDOWS = 50
"""A rate is a difference over a run's length divided by this number, but at least over two samples."""
THRESHOLDS = (0.01, 0.03, 0.1, 0.3)
DEGREE = 3

Bools = NDArray[np.bool_]
Rate = Callable[[Array], Array]
"""dP/dt, kPa/s, as a function of rows (n, 2): scaled pressure, and input."""


class Rates(NamedTuple):
    """Rows (n, 2): scaled pressure, and input. And dP/dt (n,), kPa/s."""

    at: Array
    kPa_per_s: Array


def unseen_errors(runs: Sequence[Readings]) -> dict[str, float]:
    """Error of each method on unseen readings, divided by the measured range."""
    odd = [in_odd_stretch(run.time_s) for run in runs]
    halves = (odd, [~mask for mask in odd])
    if len(runs) > 1:
        whole = [np.ones(len(run.time_s), dtype=np.bool_) for run in runs]
        splits = [[mask if i == k else ~mask for k, mask in enumerate(whole)] for i in range(len(runs))]
    else:
        splits = [*halves]
    return {
        "exponential": _error(runs, halves, _exponentials),
        "pysindy": _error(runs, splits, lambda *shown: _simulated(_sparse, *shown)),
        "Gaussian process": _error(runs, splits, lambda *shown: _simulated(_process, *shown)),
    }


def _error(
    runs: Sequence[Readings],
    splits: Sequence[Sequence[Bools]],
    predict: Callable[[Sequence[Readings], Sequence[Bools]], list[Array]],
) -> float:
    """The error over all splits. A split has a mask (n,) of the unseen readings of each run."""
    left = []
    for unseen in splits:
        predicted = predict(runs, [~mask for mask in unseen])
        for run, mask, one in zip(runs, unseen, predicted, strict=True):
            left.append((one - run.pressure_kPa)[mask])
    read = np.concatenate([run.pressure_kPa for run in runs])
    return float(np.sqrt(np.mean(np.concatenate(left) ** 2)) / np.ptp(read))


def _exponentials(runs: Sequence[Readings], shown: Sequence[Bools]) -> list[Array]:
    return [_exponential(run, mask) for run, mask in zip(runs, shown, strict=True)]


def _exponential(run: Readings, shown: Bools) -> Array:
    changed = np.flatnonzero(np.diff(run.input))
    begin_s = float(run.time_s[changed[0] + 1] if len(changed) else run.time_s[0])
    since_s = np.clip(run.time_s - begin_s, 0.0, None)
    first, last = float(run.pressure_kPa[0]), float(run.pressure_kPa[-1])

    def curve(x: Array) -> Array:
        drawn: Array = x[0] + x[1] * np.exp(-since_s / np.exp(x[2]))
        return drawn

    start = [last, first - last, np.log(since_s[-1] / 3.0)]
    fit = least_squares(lambda x: (curve(x) - run.pressure_kPa)[shown], start, x_scale=[1.0, 1.0, 0.1])
    return curve(fit.x)


def _simulated(
    learn: Callable[[Rates], Rate], runs: Sequence[Readings], shown: Sequence[Bools]
) -> list[Array]:
    read = np.concatenate([run.pressure_kPa for run in runs])
    low_kPa, high_kPa = float(read.min()), float(read.max())
    middle_kPa, half_kPa = (high_kPa + low_kPa) / 2.0, (high_kPa - low_kPa) / 2.0

    def rows(pressure_kPa: Array, inputs: Array) -> Array:
        return np.stack(((pressure_kPa - middle_kPa) / half_kPa, inputs), axis=1)

    rates = [_rates(run, mask, rows) for run, mask in zip(runs, shown, strict=True)]
    rate = learn(Rates(np.concatenate([r.at for r in rates]), np.concatenate([r.kPa_per_s for r in rates])))
    predicted = []
    for run in runs:
        pressure_kPa = np.empty_like(run.time_s)
        now_kPa = float(run.pressure_kPa[0])
        for i, dt_s in enumerate([*np.diff(run.time_s), 0.0]):
            pressure_kPa[i] = now_kPa
            per_s = float(rate(rows(np.array([now_kPa]), run.input[i : i + 1]))[0])
            # The learned rates are not valid far outside the measured range.
            now_kPa = float(np.clip(now_kPa + dt_s * per_s, low_kPa - half_kPa, high_kPa + half_kPa))
        predicted.append(pressure_kPa)
    return predicted


def _rates(run: Readings, shown: Bools, rows: Callable[[Array, Array], Array]) -> Rates:
    n = max(2, len(run.time_s) // WINDOWS)
    per_s = (run.pressure_kPa[n:] - run.pressure_kPa[:-n]) / (run.time_s[n:] - run.time_s[:-n])
    hidden = np.concatenate(([0], np.cumsum(~shown)))
    whole = hidden[n + 1 :] == hidden[: -n - 1]
    middle = (run.pressure_kPa[n:] + run.pressure_kPa[:-n]) / 2.0
    held = np.concatenate(([0.0], np.cumsum(run.input)))
    return Rates(rows(middle, (held[n:-1] - held[: -n - 1]) / n)[whole], per_s[whole])


def _sparse(rates: Rates) -> Rate:
    """Uses the threshold that best predicts every other block of the rates."""
    library = PolynomialLibrary(degree=DEGREE).fit(rates.at)
    every = np.asarray(library.transform(rates.at))
    # An input that never changes has columns of zeros.
    terms = np.flatnonzero(np.linalg.norm(every, axis=0) > 0.0)
    columns = every[:, terms]
    odd = np.arange(len(columns)) * 8 // len(columns) % 2 == 1

    def fitted(threshold: float, used: Bools) -> Array:
        regression = STLSQ(threshold * float(np.linalg.norm(rates.kPa_per_s)), normalize_columns=True)
        with warnings.catch_warnings():
            # STLSQ warns if a threshold leaves no term, which is a valid result.
            warnings.simplefilter("ignore")
            regression.fit(columns[used], rates.kPa_per_s[used, None])
        found: Array = np.asarray(regression.coef_[0], dtype=np.float64)
        return found

    def missed(threshold: float) -> float:
        errors = [(columns[~part] @ fitted(threshold, part) - rates.kPa_per_s[~part]) for part in (odd, ~odd)]
        return float(np.sum(np.concatenate(errors) ** 2))

    best = fitted(min(THRESHOLDS, key=missed), np.ones_like(odd))
    return lambda at: np.asarray(library.transform(at))[:, terms] @ best


def _process(rates: Rates) -> Rate:
    taken = np.unique(np.linspace(0, len(rates.at) - 1, MAX_ROWS).astype(int))
    scale = max(float(rates.kPa_per_s.std()), 1e-12)
    kernel = ConstantKernel(1.0, (1e-3, 1e3)) * RBF(np.ones(2), (0.1, 100.0)) + WhiteKernel(0.1, (1e-6, 2.0))
    process = GaussianProcessRegressor(kernel)
    with warnings.catch_warnings():
        # sklearn warns if the scale of an input ends at its bound, because the input does not matter.
        warnings.simplefilter("ignore", ConvergenceWarning)
        process.fit(rates.at[taken], rates.kPa_per_s[taken] / scale)
    return lambda at: np.asarray(process.predict(at)) * scale
