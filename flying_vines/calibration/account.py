"""The bottle's account: what left it for what, so that the air of each movement is known from its pressure.

Whatever takes air has a column F_j(t): by how much it would have lowered the bottle by then, per unit of
its parameter θ_j, were the bottle always at ambient temperature. But what stays behind a flow is cold for a
while, and so is the wall (ϑ, ϑ_w: deviations from ambient temperature, as shares of it; p absolute, and as
it would be at ambient temperature):

    P_r = P_0 − Σ θ_j F_j + p ϑ
    dϑ/dt = −(γ−1) (1+ϑ)/p Σ θ_j dF_j/dt − h (γ−1) T_a / (p V) (ϑ − ϑ_w)
    dϑ_w/dt = h/C (ϑ − ϑ_w) − h_o/C ϑ_w

Linear in the θ_j, in P_0 and in what warmth there was at the start; nonlinear in h, C and h_o, of which a
bottle's usual ones are the prior. All are fitted at once to means over `BIN_S`, by least squares.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from flying_vines.calibration.estimate import Estimate
from flying_vines.calibration.readings import Readings
from flying_vines.physics.arrays import Array, BoolArray
from flying_vines.physics.constants import GAMMA, STANDARD_PRESSURE_KPA, STANDARD_TEMPERATURE_K
from flying_vines.supply.belief import bottle_wall

BIN_S = 0.2
BLOCK = 25
"""Bins (5 s): what neighbouring residuals have in common makes the intervals wider."""
LEAST_SD_KPA = 1e-3
_HEAT_SD = np.array([0.6, 0.4, 0.6])
"""Of ln h, ln C, ln h_o."""
_HEAT_REACH = 4.0
"""So far, in ln, they may go: gas that stays at its temperature has a very large h."""
_WARMTH_SD = np.array([0.03, 0.02])
"""Of ϑ and ϑ_w at the start: a bottle that was just filled is warm."""
_ITERATIONS = 20
SIMPLER = 10.0
"""So much worse, in χ², heat may be left out: three numbers fit some noise."""
_ROUNDS = 3
"""Of the gas's temperature, which its mass and so its cooling depend on."""
_STEP = 1e-4


class AccountPrior(NamedTuple):
    """What is known beforehand, and its standard deviation."""

    mean: float
    sd: float


@dataclass(frozen=True)
class Bins:
    """Means over `BIN_S`, (n,) each; a bin without rows is left out."""

    t_s: Array
    cv_kPa: Array
    reservoir_kPa: Array
    columns: Mapping[str, Array]
    """Cumulative, kPa per unit of the parameter."""
    counts: BoolArray
    """Which are fitted; in the others gas of the vine is still warm, and pressure does not tell its air."""
    noise_kPa: float
    """Standard deviation of a mean."""


@dataclass(frozen=True)
class Balance:
    """An account that was settled."""

    bins: Bins
    values: Mapping[str, Estimate]
    """Of the columns' parameters."""
    fitted_kPa: Array
    cold_kPa: Array
    """By how much cold (below 0) or warmth moves the reading."""

    covariance: Array
    """Of the columns' parameters, in their order."""

    def of(self, weights: Mapping[str, float]) -> Estimate:
        """A weighted sum of parameters."""
        names = list(self.bins.columns)
        w = np.array([weights.get(name, 0.0) for name in names])
        value = sum(weight * self.values[name].value for name, weight in weights.items())
        return Estimate(float(value), float(np.sqrt(w @ self.covariance @ w)))

    def without(self, *names: str) -> Array:
        """The bottle's readings at ambient temperature, had it kept what these took."""
        given = sum(self.values[name].value * self.bins.columns[name] for name in names)
        return self.bins.reservoir_kPa - self.cold_kPa + given


def binned(readings: Readings, columns: Mapping[str, Array], counts: BoolArray, noise_kPa: float) -> Bins:
    """Rows into bins; a bin counts when all of its rows do. `noise_kPa`: of a single reading."""
    index = np.floor((readings.t_s - readings.t_s[0]) / BIN_S).astype(int)
    rows = np.bincount(index)
    there = rows > 0

    def mean(column: Array) -> Array:
        return np.asarray(np.bincount(index, weights=column)[there] / rows[there])

    return Bins(
        mean(readings.t_s),
        mean(readings.cv_kPa),
        mean(readings.reservoir_kPa),
        {name: mean(column) for name, column in columns.items()},
        mean(counts.astype(float)) > 1.0 - 1e-9,
        max(LEAST_SD_KPA, noise_kPa / float(np.sqrt(np.median(rows[there])))),
    )


def settle(
    bins: Bins,
    priors: Mapping[str, AccountPrior],
    bottle_L: float,
    ambient_kPa: float = STANDARD_PRESSURE_KPA,
) -> Balance:
    """The parameters of the columns, of a bottle of about this volume; ambient pressure is absolute."""
    # Smooth: a factor of the model that has a reading's noise would explain that very noise.
    read_kPa = np.maximum(_smooth(bins.reservoir_kPa), 0.0) + ambient_kPa
    heat = _usual_heat(bottle_L)
    ratio = np.ones_like(read_kPa)
    for _ in range(_ROUNDS):
        ledger = _Ledger(bins, priors, bottle_L, read_kPa / ratio, ratio)
        heat = ledger.best_heat(heat)
        ratio = 1.0 + ledger.warmth(heat)
    # A simulated bottle may stay at its temperature: where that explains the readings better, it does.
    still = _Ledger(bins, priors, bottle_L, read_kPa, np.ones_like(read_kPa))
    none = np.full(3, np.inf)
    if still.cost(none) < ledger.cost(heat) + SIMPLER:
        return still.balance(none)
    return ledger.balance(heat)


class _Ledger:
    """The least squares, linearised about what is known of the gas's temperature ratio 1 + ϑ."""

    def __init__(
        self, bins: Bins, priors: Mapping[str, AccountPrior], bottle_L: float, p_kPa: Array, ratio: Array
    ) -> None:
        self._bins = bins
        self._bottle_L = bottle_L
        self._p_kPa = p_kPa
        """Absolute, at ambient temperature."""
        self._ratio = ratio
        self._names = names = list(bins.columns)
        self._columns = np.array([bins.columns[name] for name in names]).reshape(len(names), len(p_kPa))
        self._usual = _usual_heat(bottle_L)
        known = [name for name in names if name in priors]
        self._priors = np.zeros((len(known) + 2, len(names) + 3))
        for row, name in enumerate(known):
            self._priors[row, names.index(name)] = 1.0 / priors[name].sd
        self._priors[-2:, -2:] = np.diag(1.0 / _WARMTH_SD)
        expected = [priors[name].mean / priors[name].sd for name in known]
        read = bins.reservoir_kPa[bins.counts] / bins.noise_kPa
        self._target = np.concatenate([read, expected, [0.0, 0.0]])

    def best_heat(self, heat: Array) -> Array:
        """By Levenberg's and Marquardt's method, from here."""
        _, residual = self._left(heat)
        damping = 1e-2
        for _ in range(_ITERATIONS):
            slopes = np.array([(self._left(heat + d)[1] - residual) / _STEP for d in _STEP * np.eye(3)]).T
            normal = slopes.T @ slopes
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), slopes.T @ residual)
            tried = np.clip(heat - step, self._usual - _HEAT_REACH, self._usual + _HEAT_REACH)
            _, tried_residual = self._left(tried)
            gained = float(residual @ residual - tried_residual @ tried_residual)
            damping *= 10.0 if gained <= 0.0 else 0.1
            if gained > 0.0:
                heat, residual = tried, tried_residual
            if damping > 1e4 or 0.0 < gained < 1e-2:
                break
        return heat

    def cost(self, heat: Array) -> float:
        """χ² of readings and priors."""
        _, residual = self._left(heat)
        return float(residual @ residual)

    def warmth(self, heat: Array) -> Array:
        """ϑ as fitted, (bins,)."""
        best, _ = self._left(heat)
        n = len(self._names)
        return np.asarray(self._warmth(heat).T @ np.concatenate([best[:n], best[n + 1 :]]))

    def balance(self, heat: Array) -> Balance:
        """What it comes to."""
        best, _ = self._left(heat)
        a = self._design(heat)
        whole = a
        if np.isfinite(heat).all():
            bends = np.array([(self._design(heat + d) - a) @ best / _STEP for d in _STEP * np.eye(3)]).T
            below = np.hstack([np.zeros((3, a.shape[1])), np.diag(1.0 / _HEAT_SD)])
            whole = np.vstack([np.hstack([a, bends]), below])
        fitted = self._model(heat) @ best
        off = (self._bins.reservoir_kPa - fitted)[self._bins.counts] / self._bins.noise_kPa
        n = len(self._names)
        # Parameters are of very different sizes: each in its own unit, for the inverse's sake.
        unit = 1.0 / np.linalg.norm(whole, axis=0)
        scaled = whole * unit
        covariance = np.outer(unit, unit) * np.linalg.pinv(scaled.T @ scaled) * _sharing(off)
        covariance = covariance[:n, :n]
        values = {
            name: Estimate(float(value), float(error))
            for name, value, error in zip(self._names, best, np.sqrt(np.diag(covariance)), strict=False)
        }
        return Balance(self._bins, values, fitted, self._p_kPa * self.warmth(heat), covariance)

    def _left(self, heat: Array) -> tuple[Array, Array]:
        """The best linear parameters for this heat, and what is left."""
        a = self._design(heat)
        best = np.linalg.lstsq(a, self._target, rcond=None)[0]
        unusual = (self._usual - heat) / _HEAT_SD if np.isfinite(heat).all() else np.zeros(3)
        return best, np.concatenate([self._target - a @ best, unusual])

    def _design(self, heat: Array) -> Array:
        bins = self._bins
        return np.vstack([self._model(heat)[bins.counts] / bins.noise_kPa, self._priors])

    def _model(self, heat: Array) -> Array:
        """What columns' parameters, P_0 and the two warmths at the start multiply, (bins, parameters)."""
        n = len(self._names)
        warmth = self._p_kPa * self._warmth(heat)
        return np.vstack([warmth[:n] - self._columns, np.ones((1, len(self._p_kPa))), warmth[n:]]).T

    def _warmth(self, heat: Array) -> Array:
        """ϑ for a unit of each column, then for a unit of ϑ and of ϑ_w at the start: (columns + 2, bins).

        None at all where heat is without limit.
        """
        if not np.isfinite(heat).all():
            return np.zeros((len(self._names) + 2, len(self._p_kPa)))
        inner, capacity, outer = np.exp(heat)
        n = len(self._names)
        gas, wall = np.zeros(n + 2), np.zeros(n + 2)
        gas[n] = wall[n + 1] = 1.0
        fresh = np.zeros((n + 2, len(self._p_kPa)))
        fresh[:n, 1:] = -(GAMMA - 1.0) * np.diff(self._columns, axis=1) * (self._ratio / self._p_kPa)[1:]
        warmth = np.empty_like(fresh)
        steps_s = np.diff(self._bins.t_s, prepend=self._bins.t_s[0])
        # Implicitly, so that gas which a wall warms at once needs no short steps.
        into_gas = steps_s * inner * (GAMMA - 1.0) * STANDARD_TEMPERATURE_K / (self._p_kPa * self._bottle_L)
        into_wall, out = steps_s * inner / capacity, steps_s * outer / capacity
        after = 1.0 + into_wall + out
        for k in range(len(steps_s)):
            a, b = into_gas[k], into_wall[k]
            gas = (gas + fresh[:, k] + a * wall / after[k]) / (1.0 + a - a * b / after[k])
            wall = (wall + b * gas) / after[k]
            warmth[:, k] = gas
        return warmth


def _usual_heat(bottle_L: float) -> Array:
    wall = bottle_wall(bottle_L)
    return np.log([wall.conductance_W_per_K, wall.capacity_J_per_K, wall.outer_conductance_W_per_K])


def _smooth(column: Array) -> Array:
    """Means over `BLOCK` neighbours, fewer at the ends."""
    sums = np.concatenate([[0.0], np.cumsum(column)])
    at = np.arange(len(column))
    begin, end = np.maximum(at - BLOCK // 2, 0), np.minimum(at + BLOCK // 2 + 1, len(column))
    return np.asarray((sums[end] - sums[begin]) / (end - begin))


def _sharing(residual: Array) -> float:
    """By how much the variance of what is fitted is greater than that of independent noise."""
    white = float(np.mean(residual**2))
    blocks = residual[: len(residual) // BLOCK * BLOCK].reshape(-1, BLOCK).mean(axis=1)
    common = BLOCK * float(np.mean(blocks**2)) if len(blocks) > 2 else white
    return max(1.0, white, common)
