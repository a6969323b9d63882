"""pysindy's sparse regression, with a library of physical terms, and a table of the cause of each term.

dP/dt of each pressure is regressed on the baseline's own terms and on further terms: products of openings and
pressures, and the flow that is missing while a valve turns late. The threshold is the largest one that
predicts unseen runs as well as the best one. A chosen further term names a cause. If no further term is
chosen, the coefficients of the baseline's own terms may name one: a cause changes a group of them
(`TOGETHER`).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from discrepancy_rates import Series, inflation, motive, outlet, per_SL, series, stacked
from numpy.typing import NDArray
from pysindy.optimizers import STLSQ

from flying_vines.identification.case import Case
from flying_vines.identification.fit import FitProblem
from flying_vines.identification.noise import SensorNoise
from flying_vines.identification.verdict import NONE, UNEXPLAINED
from flying_vines.physics.arrays import Array

THRESHOLDS = np.geomspace(1e-3, 0.5, 16)
"""The thresholds that are tried: minimum share of a term in the rates."""
RIDGE = 1e-4
SURE = 16.0
"""Deviations of the coefficients from nominal are not significant below this χ²."""
TOGETHER = {
    "reservoir_volume": (1.0, 1.0, 0.0, 0.0),
    "evp_restriction": (1.0, 0.0, 1.0, 0.0),
    "dead_volume": (0.0, 0.0, 1.0, 1.0),
    "cv_sensor_gain": (0.0, 0.0, 1.0, 0.0),
}
"""The coefficients that a cause changes by the same factor: inflation and Venturi for the reservoir,
inflation and outlet for the control volume."""
ALIKE = {"cv_sensor_gain": ("reservoir_sensor_gain",)}

Terms = dict[str, Array]


class Equation(NamedTuple):
    """The equation of one pressure."""

    extra: dict[str, float]
    """Causes of the further terms: the rise of χ² without the term, after a refit of all others."""
    coefficients: Array
    """Of the baseline's own terms; 1 is the nominal value."""
    errors: Array
    """Their standard errors."""


NOT_READ = Equation({}, np.ones(2), np.full(2, np.inf))


def look(case: Case) -> dict[str, Any]:
    problem = FitProblem(case, (SensorNoise(1.0), SensorNoise(1.0)))
    runs = series(problem, problem.start())
    read = [np.isfinite(run.reservoir_kPa).any() for run in case.runs]
    reservoir = _equation(case, runs, 0, _reservoir) if all(read) else NOT_READ
    read = [np.isfinite(run.cv_kPa).any() for run in case.runs]
    cv = _equation(case, runs, 1, _cv) if all(read) else NOT_READ
    extra = dict(reservoir.extra)
    for cause, missed in cv.extra.items():
        extra[cause] = missed + extra.get(cause, 0.0)
    if extra:
        first, *others = sorted(extra, key=lambda cause: -extra[cause])
        return {"cause": first, "also": [{"cause": cause} for cause in others]}
    cause = _by_coefficients(case, (reservoir, cv))
    return {"cause": cause, "indistinguishable": list(ALIKE.get(cause, ()))}


def _reservoir(case: Case, s: Series) -> tuple[Terms, Terms]:
    """The baseline's terms in kPa/s, and further terms, in any unit, by their cause."""
    gain, _ = per_SL(case)
    into, through = inflation(case.rig, s), motive(case.rig, s)
    own = {"inflation": s.mean(-gain * into), "motive": s.mean(-gain * through)}
    return own, {
        "ambient_drop": s.mean(np.ones_like(s.evp)),
        "reservoir_leak": s.mean(s.reservoir_kPa),
        "compressible_flow": s.mean((into + through) * s.reservoir_kPa),
        "reservoir_sensor_offset": s.mean(
            s.evp / case.rig.evp.flow_resistance_kPa_s_per_SL
            + s.dvp / case.rig.dvp.flow_resistance_kPa_s_per_SL
        ),
        "evp_dead_zone": s.mean(into * (1.0 - s.evp)),
        "line_delay": s.jumps(np.diff(s.evp, prepend=0.0) * (s.reservoir_kPa - s.cv_kPa)),
    }


def _cv(case: Case, s: Series) -> tuple[Terms, Terms]:
    _, gain = per_SL(case)
    into, out = inflation(case.rig, s), outlet(case.rig, s)
    own = {"inflation": s.mean(gain * into), "outlet": s.mean(-gain * out)}
    closing = np.maximum(-np.diff(s.solenoid, prepend=0.0), 0.0)
    # If the valve has just closed, the outflow of the previous step continues.
    before = np.concatenate(([0.0], out[:-1]))
    return own, {
        "ambient_drop": s.mean(np.ones_like(s.evp)),
        "cv_leak": s.mean(s.cv_kPa),
        "compressible_flow": s.mean(into * s.reservoir_kPa),
        "reservoir_sensor_offset": s.mean(s.evp),
        "cv_sensor_offset": s.mean(s.solenoid),
        "cv_compliance": s.mean((into - out) * s.cv_kPa),
        "evp_dead_zone": s.mean(into * (1.0 - s.evp)),
        "line_delay": s.jumps(np.diff(s.evp, prepend=0.0) * (s.reservoir_kPa - s.cv_kPa)),
        "solenoid_slow_close": s.jumps(closing * before),
        "venturi_stall": s.mean(s.solenoid * s.dvp * (1.0 - s.reservoir_kPa / 690.0)),
    }


def _equation(
    case: Case, runs: list[Series], channel: int, terms: Callable[[Case, Series], tuple[Terms, Terms]]
) -> Equation:
    rates, run = stacked(runs, lambda s: s.gain(s.read_kPa[channel]))
    if len(runs) == 1:
        run = np.arange(len(rates)) // -(-len(rates) // 2)
    own, extra = (
        {name: np.concatenate([one[name] for one in every]) for name in every[0]}
        for every in zip(*(terms(case, s) for s in runs), strict=True)
    )
    names = [*own, *extra]
    columns = np.stack([*own.values(), *extra.values()], axis=1)
    # A valve that is never used has a column of zeros.
    used = np.flatnonzero(np.linalg.norm(columns, axis=0) > 0.0)
    coefficients = _sparse(columns[:, used], rates, _threshold(columns[:, used], rates, run))
    chosen = used[coefficients != 0.0]
    # The order is not by the size of the coefficients: two terms that nearly cancel would come first.
    left = _left(columns[:, chosen], rates)
    found = {
        names[k]: len(rates) * (_left(columns[:, chosen[chosen != k]], rates) / left - 1.0)
        for k in chosen
        if k >= len(own)
    }
    return Equation(found, *_least_squares(columns[:, : len(own)], rates))


def _left(columns: Array, rates: Array) -> float:
    """The minimum sum of squares with these terms."""
    return float(np.sum((rates - columns @ np.linalg.lstsq(columns, rates)[0]) ** 2))


def _sparse(columns: Array, rates: Array, threshold: float) -> Array:
    """The coefficient of each term; 0 for terms that are not used."""
    regression = STLSQ(threshold * float(np.linalg.norm(rates)), alpha=RIDGE, normalize_columns=True)
    with warnings.catch_warnings():
        # STLSQ warns if a threshold leaves no term, which is a valid result.
        warnings.simplefilter("ignore")
        regression.fit(columns, rates[:, None])
    coefficients: Array = np.asarray(regression.coef_[0], dtype=np.float64)
    return coefficients


def _threshold(columns: Array, rates: Array, run: NDArray[np.int_]) -> float:
    """The largest threshold whose error on unseen runs is not significantly above the minimum."""
    errors = np.array(
        [
            [
                np.mean(
                    (rates[run == i] - columns[run == i] @ _sparse(columns[run != i], rates[run != i], t))
                    ** 2
                )
                for i in np.unique(run)
            ]
            for t in THRESHOLDS
        ]
    )
    mean = errors.mean(axis=1)
    best = int(np.argmin(mean))
    # Standard error of the difference from the best threshold, because the errors themselves differ by run.
    excess = errors - errors[best]
    doubt = excess.std(axis=1, ddof=1) / np.sqrt(errors.shape[1])
    return float(THRESHOLDS[np.flatnonzero(excess.mean(axis=1) <= doubt)[-1]])


def _least_squares(columns: Array, rates: Array) -> tuple[Array, Array]:
    """The baseline's terms alone: coefficients and standard errors."""
    information = columns.T @ columns
    used = np.diag(information) > 0.0
    coefficients, errors = np.ones(len(used)), np.full(len(used), np.inf)
    inverse = np.linalg.inv(information[np.ix_(used, used)])
    coefficients[used] = inverse @ (columns[:, used].T @ rates)
    left = rates - columns[:, used] @ coefficients[used]
    errors[used] = np.sqrt(np.diag(inverse) * float(left @ left) / len(rates))
    return coefficients, errors


def _by_coefficients(case: Case, equations: Sequence[Equation]) -> str:
    """The cause that explains the coefficients' deviations from nominal.

    NONE if the deviations are not significant, UNEXPLAINED if no cause explains them.
    """
    off = np.concatenate([equation.coefficients for equation in equations]) - 1.0
    errors = np.concatenate([equation.errors for equation in equations])
    tolerance = case.rig.tolerance("evp.flow_resistance_kPa_s_per_SL") / 100.0
    weighed = off / np.hypot(errors, tolerance)
    if float(weighed @ weighed) < SURE:
        return NONE
    left = {}
    for cause, pattern in TOGETHER.items():
        trace = np.array(pattern) / np.hypot(errors, tolerance)
        length = float(trace @ trace)
        along = float(trace @ weighed) ** 2 / length if length > 0.0 else 0.0
        left[cause] = float(weighed @ weighed) - along
    best = min(left, key=left.__getitem__)
    return best if left[best] < SURE else UNEXPLAINED
