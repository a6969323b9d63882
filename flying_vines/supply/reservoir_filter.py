"""The reservoir's air and temperature: an extended Kalman filter over a small physical model.

The gauge reads P = x − p_abs g / T. `x` is its reading with the gas at ambient temperature. The gas is colder
than ambient by `g`, the wall by `w`. Outflow lowers x and raises g. The wall warms the gas, and the ambient
air warms the wall. So a pressure that recovers after a fast outflow is no gain of air, and a cold reservoir
has lost less air than its reading shows:

    dx = −out                    out = a rise + b flat + v p_abs u_d dt + λ x dt + c P_cv dt
    dg = (γ−1) T/p_abs · out − r_g (g − w) dt    dw = r_w (g − w) dt − r_o w dt    (r: `Wall.rates`)

The learned rates are in kPa of this reservoir: `a` for each kPa of rise of the control volume, `b` for each
inflation from flat (of the actuator's bending pouch), `v` for the Venturi while its valve is open, `λ` for
the reservoir's leak, `c` for the control volume's leak. `h` scales the wall's conductances (state: ln h). So
no volume needs to be known exactly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from flying_vines.physics.gas import STANDARD_TEMPERATURE_K
from flying_vines.physics.plant.volume import COOLING_K, heat_capacity_J_per_K
from flying_vines.supply.rig_prior import AMBIENT_KPA, RigPrior

X, GAS, WALL, RISE, FLAT, VENTURI, LEAK, CV_LEAK, WARMTH = range(9)
"""Indices of x, g, w, a, b, v, λ, c and ln h in the state."""
SIZE = 9

MIN_W_PER_K = 0.1
"""Minimum conductance of a reservoir's wall."""
MAX_WARMTH = 0.8
"""Bound of |ln h| for any reservoir."""

CYCLE_SD_SHARE = 0.05
"""Standard deviation of the cost of single cycles, as a share of the cost."""
DRIFT_SHARE = 0.01
"""Drift from one cycle to the next, as a share of the cost."""
LEAK_DRIFT_PER_S = 2e-5
"""Drift of the leak in one second."""
START_SD_K = 1.5
"""Standard deviation of the gas temperature at the start, around ambient."""
REFILLED_SD_K = 8.0
GAP_KPA_PER_S = 2.0
"""Standard deviation of the air used in a gap in telemetry, for each second of the gap."""
FORGOTTEN_S = 10.0
"""After a gap of this length the temperatures are unknown again."""

# A reading is an outlier if it is off by more than both limits. After several outliers in a row the filter
# restarts: somebody has filled the reservoir, or it loses air in a new way.
JUMP_KPA = 6.0
JUMP_SDS = 6.0
JUMP_READINGS = 8
JUMP_S = 1.0


class Spent(NamedTuple):
    """The causes of an outflow during some time."""

    time_s: float
    rise_kPa: float
    """The sum of all rises of the control volume."""
    flat: float
    """The number of inflations from flat."""
    venturi_s: float
    """∫ opening of the Venturi's supply valve."""
    held_kPa_s: float
    """∫ of the control volume's gauge pressure."""


def colder_K(prior: RigPrior, heat_W: float, supply_kPa_abs: float, warmth: float) -> float:
    """How far the gas temperature is below ambient, at a constant heat flow into the gas."""
    wall = prior.wall
    gas_J_per_K = heat_capacity_J_per_K(supply_kPa_abs, prior.pneumatics.reservoir_volume_L)
    colder = heat_W / max(MIN_W_PER_K, wall.inner_W_per_K(gas_J_per_K, warmth))
    if math.isfinite(wall.capacity_J_per_K):
        colder += heat_W / max(MIN_W_PER_K, warmth * wall.outer_conductance_W_per_K)
    return colder


class Rates(NamedTuple):
    """The learned part of the state, from `RISE` on."""

    mean: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]


class ReservoirFilter:
    """The state, `mean` and `covariance`. Gauge kPa, K; rates in kPa per kPa, per inflation, per second."""

    def __init__(self, prior: RigPrior, reading_kPa: float, rates: Rates | None = None) -> None:
        self._prior = prior
        self.jumped_kPa = 0.0
        """Sum of the sudden pressure changes since this was last set to 0."""
        self._inflated_before = False
        self._outliers = 0
        start = (
            (reading_kPa, 10.0),
            (0.0, START_SD_K),
            (0.0, 0.5),
            prior.rise,
            prior.flat,
            prior.venturi,
            prior.leak,
            prior.cv_leak,
            (0.0, prior.warmth_sd),
        )
        self.mean = [mean for mean, _ in start]
        self.covariance = [
            [sd * sd if i == j else 0.0 for j in range(SIZE)] for i, (_, sd) in enumerate(start)
        ]

        if rates:
            self.mean[RISE:] = rates.mean
            for line, learned in zip(self.covariance[RISE:], rates.covariance, strict=True):
                line[RISE:] = learned

    @property
    def rates(self) -> Rates:
        return Rates(tuple(self.mean[RISE:]), tuple(tuple(line[RISE:]) for line in self.covariance[RISE:]))

    @property
    def absolute_kPa(self) -> float:
        """The absolute pressure with the gas at ambient temperature."""
        return max(1.0, self.mean[X] + AMBIENT_KPA)

    def spend(self, spent: Spent, unseen_s: float = 0.0) -> None:
        """Advance by `spent`, of which `unseen_s` was a gap in telemetry."""
        if spent.time_s > FORGOTTEN_S:
            self._restart(self.mean[X], GAP_KPA_PER_S * unseen_s + 10.0, START_SD_K)
            return
        m, p, dt = self.mean, self.covariance, spent.time_s
        p_abs = self.absolute_kPa
        per = (
            spent.rise_kPa,
            spent.flat,
            p_abs * spent.venturi_s,
            max(0.0, m[X]) * dt,
            spent.held_kPa_s,
        )
        out = sum(rate * amount for rate, amount in zip(m[RISE:WARMTH], per, strict=True))
        walls, warmth = self._prior.wall, math.exp(m[WARMTH])
        gas_J_per_K = heat_capacity_J_per_K(p_abs, self._prior.pneumatics.reservoir_volume_L)
        learned_J_per_K = warmth * walls.conductance_W_per_K * dt
        heat = walls.rates(gas_J_per_K, warmth)
        inner = min(0.9, heat.gas_per_s * dt)
        wall, outer = min(0.5, heat.wall_per_s * dt), min(0.5, heat.outer_per_s * dt)
        cooling = COOLING_K / p_abs
        apart, below = m[GAS] - m[WALL], m[WALL]
        learned_K = apart * min(0.9, learned_J_per_K / gas_J_per_K)
        self._spread(
            (1.0 - m[LEAK] * dt, 0.0, 0.0, *(-amount for amount in per), 0.0),
            (0.0, 1.0 - inner, inner, *(cooling * amount for amount in per), -learned_K),
            (
                *(0.0, wall, 1.0 - wall - outer, 0.0, 0.0, 0.0, 0.0, 0.0),
                apart * learned_J_per_K / walls.capacity_J_per_K - below * outer,
            ),
        )
        m[X] -= out
        m[GAS] += cooling * out - apart * inner
        m[WALL] += apart * wall - below * outer
        self._add_process_noise(spent, per, cooling)
        p[X][X] += (GAP_KPA_PER_S * unseen_s) ** 2

    def doubt(self, sd_kPa: float) -> None:
        """An unknown amount of air of about this size has gone. The next readings show how much."""
        self.covariance[X][X] += sd_kPa * sd_kPa

    def _spread(self, *rows: Sequence[float]) -> None:
        """F P Fᵀ, where F is the unit matrix except for its first rows."""
        p = self.covariance
        products = []
        for row in rows:
            used = [(f, p[j]) for j, f in enumerate(row) if f != 0.0]
            products.append([sum([f * line[k] for f, line in used]) for k in range(SIZE)])
        for i, product in enumerate(products):
            for k in range(i + 1):
                p[i][k] = p[k][i] = sum(map(float.__mul__, rows[k], product))
            for k in range(len(rows), SIZE):
                p[i][k] = p[k][i] = product[k]

    def _add_process_noise(self, spent: Spent, per: Sequence[float], cooling: float) -> None:
        """Cycles differ, and the model is not exact."""
        m, p = self.mean, self.covariance
        variance = (CYCLE_SD_SHARE * sum(abs(m[RISE + i]) * per[i] for i in range(3))) ** 2
        if spent.rise_kPa and not self._inflated_before:
            # A pouch that was packed flat may take more air than in later inflations.
            variance += self._prior.packed_kPa**2
            self._inflated_before = True
        p[X][X] += variance + 1e-4 * spent.time_s
        p[GAS][GAS] += cooling * cooling * variance + 1e-4 * spent.time_s
        p[X][GAS] -= cooling * variance
        p[GAS][X] = p[X][GAS]
        p[WALL][WALL] += 1e-5 * spent.time_s
        p[LEAK][LEAK] += LEAK_DRIFT_PER_S**2 * spent.time_s
        if spent.rise_kPa:
            cycles = spent.rise_kPa / self._prior.pneumatics.cycle_swing_kPa
            for i in (RISE, FLAT, CV_LEAK):
                p[i][i] += (DRIFT_SHARE * m[i]) ** 2 * cycles
        if spent.venturi_s:
            p[VENTURI][VENTURI] += (DRIFT_SHARE * m[VENTURI]) ** 2 * spent.venturi_s

    def read(self, reading_kPa: float, sd_kPa: float) -> None:
        m, p = self.mean, self.covariance
        share = self.absolute_kPa / STANDARD_TEMPERATURE_K
        projected = [line[X] - share * line[GAS] for line in p]
        variance = projected[X] - share * projected[GAS] + sd_kPa * sd_kPa
        error = reading_kPa - (m[X] - share * m[GAS])
        surprising = error * error > JUMP_SDS**2 * variance
        if surprising and abs(error) > JUMP_KPA:
            self._outliers += 1
            if self._outliers >= JUMP_READINGS:
                lost_share = max(0.0, -error) / self.absolute_kPa
                self.jumped_kPa += error
                self._restart(reading_kPa, 3.0, REFILLED_SD_K)
                p[LEAK][LEAK] += (lost_share / JUMP_S) ** 2
            return
        self._outliers = 0
        if surprising and error > 0.0:
            # Only a refill raises the pressure at once: this error shows neither a leak nor the air of bends.
            self.doubt(error)
            projected[X] += error * error
            variance += error * error
        for i, line in enumerate(p):
            gain = projected[i] / variance
            m[i] += gain * error
            for k in range(SIZE):
                line[k] -= gain * projected[k]
        m[WARMTH] = min(MAX_WARMTH, max(-MAX_WARMTH, m[WARMTH]))

    def _restart(self, reading_kPa: float, sd_kPa: float, gas_sd_K: float) -> None:
        """Start with a new filling at an unknown temperature. The learned rates stay."""
        m, p = self.mean, self.covariance
        m[X], m[GAS], m[WALL] = reading_kPa, 0.0, 0.0
        for i, sd in ((X, sd_kPa), (GAS, gas_sd_K), (WALL, 0.5)):
            for k in range(SIZE):
                p[i][k] = p[k][i] = 0.0
            p[i][i] = sd * sd
        self._outliers = 0

    def possible_mean(self) -> list[float]:
        """The mean, moved along the correlations until every rate is at its minimum or above."""
        m, p = list(self.mean), self.covariance
        minimum = {RISE: self._prior.min_rise}
        for _ in range(3):
            for i in range(RISE, WARMTH):
                short = minimum.get(i, 0.0) - m[i]
                if short > 0.0:
                    share = short / p[i][i]
                    m = [value + line[i] * share for value, line in zip(m, p, strict=True)]
        for i in range(RISE, WARMTH):
            m[i] = max(minimum.get(i, 0.0), m[i])
        return m
