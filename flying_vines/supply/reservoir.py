"""What the reservoir holds and loses: an extended Kalman filter over a small physical model.

The gauge reads P = x − p_abs g / T: `x` is what it would read with the gas at ambient temperature, `g` by
how much the gas is colder. What flows out lowers x and raises g; the wall (colder by `w`) gives the gas its
warmth back, and the air outside gives it to the wall. So a bottle that recovers after a burst has not gained
air, and a cold one has not lost what it seems to have lost:

    dx = −out                    out = a rise + b flat + v p_abs u_d dt + λ x dt + c P_cv dt
    dg = (γ−1) T/p_abs · out − r_g (g − w) dt    dw = r_w (g − w) dt − r_o w dt    (r: `Wall.rates`)

What is learned is in kPa of this very bottle: `a` for every kPa that the control volume rises, `b` for every
inflation from flat (a pouch), `v` for the Venturi while its valve is open, `λ` for the reservoir's leak, `c`
for the control volume's, and `h`, how well the wall warms (as a logarithm). So no volume need be known well.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from flying_vines.physics.constants import STANDARD_TEMPERATURE_K
from flying_vines.physics.plant.wall import COOLING_K, heat_capacity_J_per_K
from flying_vines.supply.belief import AMBIENT_KPA, Belief

X, GAS, WALL, RISE, FLAT, VENTURI, LEAK, CV_LEAK, WARMTH = range(9)
"""Places in the state, as x, g, w, a, b, v, λ, c, ln h above."""
SIZE = 9

LEAST_W_PER_K = 0.1
"""No reservoir is insulated better."""
MOST_WARMTH = 0.8
"""Bound of |ln h| for any reservoir."""

ODD_SHARE = 0.05
"""How far one cycle differs from the next, as a share of what it takes."""
DRIFT_SHARE = 0.01
"""Drift from one cycle to the next, as a share of what a cycle takes."""
LEAK_DRIFT_PER_S = 2e-5
"""In a second."""
FRESH_SD_K = 1.5
"""How far the gas of an unknown reservoir may be from ambient temperature."""
REFILLED_SD_K = 8.0
GAP_KPA_PER_S = 2.0
"""What may have been spent during a gap in telemetry."""
FORGOTTEN_S = 10.0
"""After a gap of this length the temperatures are unknown again."""

JUMP_KPA = 6.0
JUMP_SDS = 6.0
JUMP_READINGS = 8
"""A reading so far off is not believed, unless so many in a row agree: then someone has filled the reservoir,
or it has lost air in a new way."""
JUMP_S = 1.0


class Spent(NamedTuple):
    """What cost air during some time."""

    time_s: float
    rise_kPa: float
    """The sum of all rises of the control volume."""
    flat: float
    """How many inflations began with it flat."""
    venturi_s: float
    """How long the Venturi's valve was open, times its opening."""
    held_kPa_s: float
    """∫ of the control volume's gauge pressure."""


def colder_K(belief: Belief, heat_W: float, supply_kPa_abs: float, warmth: float) -> float:
    """How much colder the gas is while it takes this much heat constantly."""
    pet = belief.wall
    gas_J_per_K = heat_capacity_J_per_K(supply_kPa_abs, belief.pneumatics.reservoir_volume_L)
    colder = heat_W / max(LEAST_W_PER_K, pet.inner_W_per_K(gas_J_per_K, warmth))
    if math.isfinite(pet.capacity_J_per_K):
        colder += heat_W / max(LEAST_W_PER_K, warmth * pet.outer_conductance_W_per_K)
    return colder


class Bottle:
    """The state, `mean` and `covariance`. Gauge kPa, K, and kPa per kPa, per inflation, per second."""

    def __init__(self, belief: Belief, reading_kPa: float) -> None:
        self._belief = belief
        self._inflated_before = False
        self._odd_ones = 0
        prior = (
            (reading_kPa, 10.0),
            (0.0, FRESH_SD_K),
            (0.0, 0.5),
            belief.rise,
            belief.flat,
            belief.venturi,
            belief.leak,
            belief.cv_leak,
            (0.0, belief.warmth_sd),
        )
        self.mean = [mean for mean, _ in prior]
        self.covariance = [
            [sd * sd if i == j else 0.0 for j in range(SIZE)] for i, (_, sd) in enumerate(prior)
        ]

    @property
    def absolute_kPa(self) -> float:
        """The pressure at ambient temperature."""
        return max(1.0, self.mean[X] + AMBIENT_KPA)

    def spend(self, spent: Spent, unseen_s: float = 0.0) -> None:
        """Advance by `spent`, of which `unseen_s` was a gap in telemetry."""
        if spent.time_s > FORGOTTEN_S:
            self._restart(self.mean[X], GAP_KPA_PER_S * unseen_s + 10.0, FRESH_SD_K)
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
        pet, warmth = self._belief.wall, math.exp(m[WARMTH])
        gas_J_per_K = heat_capacity_J_per_K(p_abs, self._belief.pneumatics.reservoir_volume_L)
        learned_J_per_K = warmth * pet.conductance_W_per_K * dt
        heat = pet.rates(gas_J_per_K, warmth)
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
                apart * learned_J_per_K / pet.capacity_J_per_K - below * outer,
            ),
        )
        m[X] -= out
        m[GAS] += cooling * out - apart * inner
        m[WALL] += apart * wall - below * outer
        self._doubt(spent, per, cooling)
        p[X][X] += (GAP_KPA_PER_S * unseen_s) ** 2

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

    def _doubt(self, spent: Spent, per: Sequence[float], cooling: float) -> None:
        """Add process noise: cycles differ, and the model is not exact."""
        m, p = self.mean, self.covariance
        odd = (ODD_SHARE * sum(abs(m[RISE + i]) * per[i] for i in range(3))) ** 2
        if spent.rise_kPa and not self._inflated_before:
            # A pouch that has lain flat since it was packed takes air that later inflations may not.
            odd += self._belief.packed_kPa**2
            self._inflated_before = True
        p[X][X] += odd + 1e-4 * spent.time_s
        p[GAS][GAS] += cooling * cooling * odd + 1e-4 * spent.time_s
        p[X][GAS] -= cooling * odd
        p[GAS][X] = p[X][GAS]
        p[WALL][WALL] += 1e-5 * spent.time_s
        p[LEAK][LEAK] += LEAK_DRIFT_PER_S**2 * spent.time_s
        if spent.rise_kPa:
            cycles = spent.rise_kPa / 20.0
            for i in (RISE, FLAT, CV_LEAK):
                p[i][i] += (DRIFT_SHARE * m[i]) ** 2 * cycles
        if spent.venturi_s:
            p[VENTURI][VENTURI] += (DRIFT_SHARE * m[VENTURI]) ** 2 * spent.venturi_s

    def read(self, reading_kPa: float, sd_kPa: float) -> None:
        """Update with a reading of the pressure."""
        m, p = self.mean, self.covariance
        share = self.absolute_kPa / STANDARD_TEMPERATURE_K
        seen = [line[X] - share * line[GAS] for line in p]
        variance = seen[X] - share * seen[GAS] + sd_kPa * sd_kPa
        error = reading_kPa - (m[X] - share * m[GAS])
        if abs(error) > JUMP_KPA and error * error > JUMP_SDS**2 * variance:
            self._odd_ones += 1
            if self._odd_ones >= JUMP_READINGS:
                lost_share = max(0.0, -error) / self.absolute_kPa
                self._restart(reading_kPa, 3.0, REFILLED_SD_K)
                p[LEAK][LEAK] += (lost_share / JUMP_S) ** 2
            return
        self._odd_ones = 0
        for i, line in enumerate(p):
            gain = seen[i] / variance
            m[i] += gain * error
            for k in range(SIZE):
                line[k] -= gain * seen[k]
        m[WARMTH] = min(MOST_WARMTH, max(-MOST_WARMTH, m[WARMTH]))

    def _restart(self, reading_kPa: float, sd_kPa: float, gas_sd_K: float) -> None:
        """Start with a new filling at an unknown temperature; what cycles take is kept."""
        m, p = self.mean, self.covariance
        m[X], m[GAS], m[WALL] = reading_kPa, 0.0, 0.0
        for i, sd in ((X, sd_kPa), (GAS, gas_sd_K), (WALL, 0.5)):
            for k in range(SIZE):
                p[i][k] = p[k][i] = 0.0
            p[i][i] = sd * sd
        self._odd_ones = 0

    def possible_mean(self) -> list[float]:
        """The mean, moved along the correlations until no rate is negative and a rise takes its least air."""
        m, p = list(self.mean), self.covariance
        least = {RISE: self._belief.least_rise}
        for _ in range(3):
            for i in range(RISE, WARMTH):
                short = least.get(i, 0.0) - m[i]
                if short > 0.0:
                    share = short / p[i][i]
                    m = [value + line[i] * share for value, line in zip(m, p, strict=True)]
        for i in range(RISE, WARMTH):
            m[i] = max(least.get(i, 0.0), m[i])
        return m
