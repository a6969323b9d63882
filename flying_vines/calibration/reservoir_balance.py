"""Mass and heat balance of the reservoir: its pressure shows how much air each consumer took.

Each consumer j has a parameter θ_j and a column F_j(t). The column is the fall of the reservoir's pressure
that the consumer has caused up to time t, per unit of θ_j, for gas at ambient temperature. But outflow cools
the gas, and the cold wall recovers slowly. ϑ and ϑ_w are the temperatures of gas and wall, as relative
deviations from ambient temperature. p is the absolute pressure that the gas would have at ambient
temperature:

    P_r = P_0 − Σ θ_j F_j + p ϑ
    dϑ/dt = −(γ−1) (1+ϑ)/p Σ θ_j dF_j/dt − a (ϑ − ϑ_w)
    dϑ_w/dt = b (ϑ − ϑ_w) − c ϑ_w                           a, b, c: `Wall.rates`

The model is linear in the θ_j, in P_0 and in both temperatures at the start. It is nonlinear in the two
conductances and the heat capacity of the wall; the usual values of a reservoir are their prior. All
parameters are fitted together to means over `BIN_S`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from flying_vines.calibration.findings import Estimate
from flying_vines.calibration.readings import Readings, smooth
from flying_vines.physics.arrays import Array, BoolArray
from flying_vines.physics.gas import GAMMA, STANDARD_PRESSURE_KPA
from flying_vines.physics.plant.volume import Wall, heat_capacity_J_per_K
from flying_vines.supply.rig_prior import Prior, pet_wall

BIN_S = 0.2
BLOCK = 25
"""Bins of a block (5 s). Residuals that are alike within a block widen the intervals."""
MIN_SD_KPA = 1e-3
_HEAT_SD = np.array([0.6, 0.4, 0.6])
"""Prior standard deviations of ln conductance, ln capacity and ln outer conductance of the wall."""
_HEAT_RANGE = 4.0
"""Maximum deviation of these logarithms from their usual values. With a very large conductance the gas is
isothermal."""
_START_SD = np.array([0.03, 0.02])
"""Prior standard deviations of ϑ and ϑ_w at the start: a reservoir that was just filled is warm."""
ISOTHERMAL_CHI2 = 10.0
"""The isothermal model is used if its χ² is higher by less than this: the three heat parameters of the other
model also fit some noise."""
_ROUNDS = 3
"""Iterations of the gas temperature: the mass depends on it, and the cooling on the mass."""
_STEP = 1e-4
_FTOL = 1e-5
"""The fit of the heat parameters ends if a step lowers χ² by a smaller share."""


@dataclass(frozen=True)
class Bins:
    """Means over `BIN_S`, (n,) each. Bins without rows are omitted."""

    t_s: Array
    cv_kPa: Array
    reservoir_kPa: Array
    columns: Mapping[str, Array]
    """Cumulative, kPa per unit of the parameter."""
    counts: BoolArray
    """True for bins that are fitted. In the other bins the vine's gas is still warm, so its pressure does not
    show the amount of air."""
    noise_kPa: float
    """Standard deviation of a mean."""


@dataclass(frozen=True)
class Balance:
    """A fitted balance."""

    bins: Bins
    values: Mapping[str, Estimate]
    """The parameters of the columns."""
    fitted_kPa: Array
    cold_kPa: Array
    """p ϑ: change of the reading by the gas temperature; negative if the gas is cold."""

    covariance: Array
    """Covariance of all parameters, in the order of the columns."""

    def weighted_sum(self, weights: Mapping[str, float]) -> Estimate:
        names = list(self.bins.columns)
        w = np.array([weights.get(name, 0.0) for name in names])
        value = sum(weight * self.values[name].value for name, weight in weights.items())
        return Estimate(float(value), float(np.sqrt(w @ self.covariance @ w)))

    def without(self, *names: str) -> Array:
        """The reservoir's pressure at ambient temperature if these consumers had taken nothing."""
        taken = sum(self.values[name].value * self.bins.columns[name] for name in names)
        return self.bins.reservoir_kPa - self.cold_kPa + taken


def binned(readings: Readings, columns: Mapping[str, Array], counts: BoolArray, noise_kPa: float) -> Bins:
    """The readings as bins. A bin is fitted if `counts` is True in all its rows.

    `noise_kPa`: standard deviation of a single reading.
    """
    index = np.floor((readings.t_s - readings.t_s[0]) / BIN_S).astype(int)
    rows = np.bincount(index)
    used = rows > 0

    def mean(column: Array) -> Array:
        return np.asarray(np.bincount(index, weights=column)[used] / rows[used])

    return Bins(
        mean(readings.t_s),
        mean(readings.cv_kPa),
        mean(readings.reservoir_kPa),
        {name: mean(column) for name, column in columns.items()},
        mean(counts.astype(float)) > 1.0 - 1e-9,
        max(MIN_SD_KPA, noise_kPa / float(np.sqrt(np.median(rows[used])))),
    )


def fit_balance(
    bins: Bins,
    priors: Mapping[str, Prior],
    reservoir_L: float,
    ambient_kPa: float = STANDARD_PRESSURE_KPA,
) -> Balance:
    """Fit all parameters; ambient pressure is absolute."""
    # Smoothed: this pressure is a factor of the model. With its noise, the model would fit the same noise in
    # the readings.
    read_kPa = np.maximum(smooth(bins.reservoir_kPa, BLOCK), 0.0) + ambient_kPa
    wall = pet_wall(reservoir_L)
    usual = heat = np.log([wall.conductance_W_per_K, wall.capacity_J_per_K, wall.outer_conductance_W_per_K])
    ratio = np.ones_like(read_kPa)
    for _ in range(_ROUNDS):
        fit = _BalanceFit(bins, priors, usual, reservoir_L, read_kPa / ratio, ratio)
        bounds = usual - _HEAT_RANGE, usual + _HEAT_RANGE
        heat = least_squares(fit.residual, heat, bounds=bounds, diff_step=_STEP, ftol=_FTOL).x
        ratio = 1.0 + fit.gas(heat)
    # A simulated reservoir may be isothermal.
    isothermal = _BalanceFit(bins, priors, usual, reservoir_L, read_kPa, np.ones_like(read_kPa))
    if isothermal.chi2(None) < fit.chi2(heat) + ISOTHERMAL_CHI2:
        return isothermal.balance(None)
    return fit.balance(heat)


class _BalanceFit:
    """The linear least squares for given heat parameters, linearised about the gas temperature ratio 1 + ϑ.

    Heat parameters: ln conductance, ln capacity, ln outer conductance; None for isothermal gas.
    """

    def __init__(
        self,
        bins: Bins,
        priors: Mapping[str, Prior],
        usual_heat: Array,
        reservoir_L: float,
        p_kPa: Array,
        ratio: Array,
    ) -> None:
        self._bins = bins
        self._usual = usual_heat
        self._p_kPa = p_kPa
        self._capacity_J_per_K = heat_capacity_J_per_K(p_kPa, reservoir_L)
        self._names = names = list(bins.columns)
        self._columns = np.array([bins.columns[name] for name in names]).reshape(len(names), len(p_kPa))
        self._cooling = np.zeros_like(self._columns)
        self._cooling[:, 1:] = -(GAMMA - 1.0) * np.diff(self._columns, axis=1) * (ratio / p_kPa)[1:]
        known = [name for name in names if name in priors]
        self._priors = np.zeros((len(known) + 2, len(names) + 3))
        for row, name in enumerate(known):
            self._priors[row, names.index(name)] = 1.0 / priors[name].sd
        self._priors[-2:, -2:] = np.diag(1.0 / _START_SD)
        expected = [priors[name].mean / priors[name].sd for name in known]
        read = bins.reservoir_kPa[bins.counts] / bins.noise_kPa
        self._target = np.concatenate([read, expected, [0.0, 0.0]])

    def residual(self, heat: Array | None) -> Array:
        """The residuals with the best linear parameters; the last three are those of the heat parameters."""
        design = self._design(heat)
        unusual = np.zeros(3) if heat is None else (self._usual - heat) / _HEAT_SD
        return np.concatenate([self._target - design @ self._best(design), unusual])

    def chi2(self, heat: Array | None) -> float:
        """χ² of the readings and of the priors."""
        residual = self.residual(heat)
        return float(residual @ residual)

    def _best(self, design: Array) -> Array:
        """The best linear parameters."""
        return np.asarray(np.linalg.lstsq(design, self._target, rcond=None)[0])

    def gas(self, heat: Array | None) -> Array:
        """The fitted ϑ, (bins,)."""
        best, n = self._best(self._design(heat)), len(self._names)
        return np.asarray(self._temperatures(heat).T @ np.concatenate([best[:n], best[n + 1 :]]))

    def balance(self, heat: Array | None) -> Balance:
        """All results with their covariance."""
        whole = design = self._design(heat)
        best = self._best(design)
        if heat is not None:
            derivatives = [(self._design(heat + d) - design) @ best / _STEP for d in _STEP * np.eye(3)]
            prior = np.hstack([np.zeros((3, design.shape[1])), np.diag(1.0 / _HEAT_SD)])
            whole = np.vstack([np.hstack([design, np.array(derivatives).T]), prior])
        fitted = self._model(heat) @ best
        residual = (self._bins.reservoir_kPa - fitted)[self._bins.counts] / self._bins.noise_kPa
        n = len(self._names)
        # Scaled, because the parameters differ by orders of magnitude.
        unit = 1.0 / np.linalg.norm(whole, axis=0)
        scaled = whole * unit
        covariance = np.outer(unit, unit) * np.linalg.pinv(scaled.T @ scaled) * _variance_factor(residual)
        covariance = covariance[:n, :n]
        values = {
            name: Estimate(float(value), float(sd))
            for name, value, sd in zip(self._names, best, np.sqrt(np.diag(covariance)), strict=False)
        }
        return Balance(self._bins, values, fitted, self._p_kPa * self.gas(heat), covariance)

    def _design(self, heat: Array | None) -> Array:
        bins = self._bins
        return np.vstack([self._model(heat)[bins.counts] / bins.noise_kPa, self._priors])

    def _model(self, heat: Array | None) -> Array:
        """Factors of the columns' parameters, of P_0 and of both temperatures at the start, (bins, …)."""
        n = len(self._names)
        warmth = self._p_kPa * self._temperatures(heat)
        return np.vstack([warmth[:n] - self._columns, np.ones((1, len(self._p_kPa))), warmth[n:]]).T

    def _temperatures(self, heat: Array | None) -> Array:
        """ϑ per unit of each column, then per unit of ϑ and of ϑ_w at the start: (columns + 2, bins)."""
        n = len(self._names)
        found = np.zeros((n + 2, len(self._p_kPa)))
        if heat is None:
            return found
        conductance, capacity, outer = np.exp(heat).tolist()
        rates = Wall(
            conductance_W_per_K=conductance, capacity_J_per_K=capacity, outer_conductance_W_per_K=outer
        ).rates(1.0)
        steps_s = np.diff(self._bins.t_s, prepend=self._bins.t_s[0])
        # Implicit Euler: it is stable with long steps, also if the wall warms the gas very fast.
        into_gas = (steps_s * rates.gas_per_s / self._capacity_J_per_K).tolist()
        into_wall, lost = (steps_s * rates.wall_per_s).tolist(), (steps_s * rates.outer_per_s).tolist()
        gas, wall = np.zeros(n + 2), np.zeros(n + 2)
        gas[n] = wall[n + 1] = 1.0
        for k, (a, b, c) in enumerate(zip(into_gas, into_wall, lost, strict=True)):
            after = 1.0 + b + c
            gas[:n] += self._cooling[:, k]
            gas = (gas + a / after * wall) / (1.0 + a - a * b / after)
            wall = (wall + b * gas) / after
            found[:, k] = gas
        return found


def _variance_factor(residual: Array) -> float:
    """How much larger the variance of the results is than with independent noise."""
    white = float(np.mean(residual**2))
    blocks = residual[: len(residual) // BLOCK * BLOCK].reshape(-1, BLOCK).mean(axis=1)
    common = BLOCK * float(np.mean(blocks**2)) if len(blocks) > 2 else white
    return max(1.0, white, common)
