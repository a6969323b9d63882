"""The air left and the cycles that it is enough for, learned in flight.

One cycle costs A + B x kPa at reservoir pressure x. A: air for the inflation. B x: leak during one cycle at
the present rate of cycles, and the Venturi. From the present pressure x₀ down to x₁, below which the
reservoir no longer fills the control volume (CV) in time, this gives

    n = ∫ dx / (A + B x) = ln((A + B x₀) / (A + B x₁)) / B

cycles. If the Venturi is off below some pressure, n has two parts. The uncertainty of all these numbers gives
the interval of ln n. Pouch: the bending pouch of the actuator.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from flying_vines.config.config import PneumaticsConfig
from flying_vines.physics.constants import STANDARD_TEMPERATURE_K
from flying_vines.supply.belief import AMBIENT_KPA, Belief
from flying_vines.supply.features import Features
from flying_vines.supply.flying import TRACE, Flying, ObservedInflation
from flying_vines.supply.formula import floor_kPa
from flying_vines.supply.reservoir import (
    CV_LEAK,
    FLAT,
    LEAK,
    RISE,
    SIZE,
    VENTURI,
    WARMTH,
    Bottle,
    Spent,
    X,
    colder_K,
)
from flying_vines.supply.supply import SupplyCost, min_supply_kPa

READING_SD_KPA = 1.3
"""Standard deviation of one reading: sensor noise and a converter of 10 bits."""
REGULATOR_SD = 0.07
"""Relative standard deviation of the minimum absolute supply, because regulators differ."""
MODEL_SD = 0.02
UNFLOWN_SD = 0.1
"""For a cycle that has not been flown yet: its duration and its vent are uncertain."""
COUNT_SD = 0.4
"""In cycles: the number is rounded to whole cycles."""
MIN_CYCLES = 1e-3
"""Keeps the logarithm finite."""
FLAT_COUNTED = 0.5
"""At low supply the Venturi is off, and the pouch does not go flat between cycles. The additional air of an
inflation may fill the pouch, or stretch it. So half of it is counted."""
VENTURI_USED_S = 0.01
"""A shorter Venturi time in a cycle counts as none."""
VENTURI_TREND = 0.3
"""Growth of the Venturi's time as its supply falls. 0: constant time. 1: constant air per cycle."""
VENTURI_TREND_SD = 0.35
MEMORY_CYCLES = 15.0
"""Averaging length over flown cycles."""
PRIOR_CYCLES = 0.05
"""Weight of the assumed cycle, in flown cycles."""
RECENT_INFLATIONS = 10
Z90 = 1.645


@dataclass(frozen=True, slots=True)
class CyclesLeft:
    """A prediction with its 90 % interval, and its basis."""

    expected: float
    low: float
    high: float
    measured_cycles: float
    """The number of flown cycles behind `cost_kPa`."""
    cost_kPa: float
    """The expected cost of one cycle at the present pressure, in kPa of the reservoir."""
    floor_kPa: float
    """The expected gauge pressure of the reservoir below which cycles are not completed in time."""


class AirNeeded(NamedTuple):
    """The air that a motion needs, in kPa of the reservoir."""

    spending_kPa: float
    """The expected cost."""
    floor_kPa: float
    """Minimum difference between reservoir and vine for the requested rate."""


class _Mix:
    """The flown cycles on average: sums in which older cycles count less."""

    def __init__(self, belief: Belief) -> None:
        p = belief.pneumatics
        self._cycle_kPa = p.cycle_swing_kPa
        self.cycles = self._assumed_cycles = PRIOR_CYCLES
        time_s = 2.0 * p.cycle_swing_kPa / p.cycle_rate_kPa_per_s
        held = 0.5 * p.cycle_swing_kPa * time_s
        cycle = (time_s, belief.cycle_rise_kPa, 1.0, belief.cycle_venturi_s, held)
        self._sums = [PRIOR_CYCLES * amount for amount in cycle]
        self._venturi_kPa_s = PRIOR_CYCLES * belief.cycle_venturi_s * (p.full_kPa + AMBIENT_KPA)

    def add(self, inflation: ObservedInflation, supply_kPa_abs: float) -> None:
        cycles = inflation.swing_kPa / self._cycle_kPa
        keep = math.exp(-cycles / MEMORY_CYCLES)
        self.cycles = keep * self.cycles + cycles
        self._assumed_cycles *= keep
        self._sums = [keep * a + b for a, b in zip(self._sums, inflation.spent, strict=True)]
        self._venturi_kPa_s = keep * self._venturi_kPa_s + inflation.spent.venturi_s * supply_kPa_abs

    @property
    def assumed_share(self) -> float:
        """The share of the assumed cycle, which was not flown."""
        return self._assumed_cycles / self.cycles

    def per_cycle(self) -> Spent:
        return Spent(*(amount / self.cycles for amount in self._sums))

    def venturi_supply_kPa(self) -> float:
        """Mean gauge supply while the Venturi's valve was open."""
        return self._venturi_kPa_s / max(1e-9, self._sums[3]) - AMBIENT_KPA

    def venturi_kPa_s(self) -> float:
        return self._venturi_kPa_s / self.cycles


class ReservoirEstimate:
    """Learns from telemetry the cost of a cycle, the leaks, and the minimum pressure for a cycle."""

    def __init__(self, belief: Belief) -> None:
        self._belief = belief
        self._p = belief.pneumatics
        self.reservoir_kPa = math.nan
        """Smoothed reading, with the sensor's gain and offset corrected; NaN before the first one."""
        self.read_at = 0.0
        self._flying = Flying(belief)
        self.bottle: Bottle | None = None
        self._demand = SupplyCost(belief)
        self._mix = _Mix(belief)
        self._inflations: list[ObservedInflation] = []
        self._warmed_up = belief.packed_kPa == 0.0
        self.measured_cycles = 0.0
        """The number of flown cycles from which the cost was learned."""

    def update(self, features: Features) -> None:
        """Take in one telemetry message."""
        if features.reservoir_kPa is not None:
            self.read_at = features.t
        if features.reservoir_smooth_kPa is not None:
            self.reservoir_kPa = features.reservoir_smooth_kPa
        if not features.complete:
            return
        flying = self._flying
        flying.take(features, self.reservoir_kPa)
        if flying.reading_kPa is not None and self.bottle is None:
            self.bottle = Bottle(self._belief, flying.reading_kPa)
        if self.bottle is None:
            return
        if flying.block is not None:
            self.bottle.spend(flying.block, flying.unseen_s)
            if flying.reading_kPa is not None:
                self.bottle.read(flying.reading_kPa, READING_SD_KPA / math.sqrt(flying.readings))
        if flying.inflation is not None:
            self._add(flying.inflation, self.bottle)

    def _add(self, inflation: ObservedInflation, bottle: Bottle) -> None:
        if not self._warmed_up:
            # The pouch was packed flat. No later cycle is like the first.
            self._warmed_up = True
            return
        self.measured_cycles += inflation.swing_kPa / self._p.cycle_swing_kPa
        self._mix.add(inflation, bottle.absolute_kPa)
        self._demand.learn(inflation, self._air_kPa(bottle.possible_mean(), inflation))
        self._inflations = [*self._inflations[1 - RECENT_INFLATIONS :], inflation]

    @staticmethod
    def _air_kPa(mean: Sequence[float], inflation: ObservedInflation) -> float:
        return mean[RISE] * inflation.swing_kPa + mean[FLAT] * inflation.spent.flat

    def air_needed(self, rise_kPa: float, rate_kPa_per_s: float) -> AirNeeded:
        """Air for raises of the CV by `rise_kPa` in total, and the supply that `rate_kPa_per_s` needs."""
        return AirNeeded(self.spending_kPa(rise_kPa), floor_kPa(self._p, rate_kPa_per_s))

    def spending_kPa(self, rise_kPa: float) -> float:
        if self.bottle is None:
            return 2.0 * self._p.cv_volume_L * rise_kPa / self._p.reservoir_volume_L
        return _Forecast(self._belief, self._mix, self.bottle.possible_mean(), 0.0).cost_kPa() * (
            rise_kPa / self._p.cycle_swing_kPa
        )

    def cycles_left(self) -> CyclesLeft | None:
        """None before the first reading."""
        return None if self.bottle is None else self._predict(self.bottle)

    def _predict(self, bottle: Bottle) -> CyclesLeft:
        mean = bottle.possible_mean()
        floor = self._floor(mean)
        forecast = _Forecast(self._belief, self._mix, mean, floor.kPa)
        expected = forecast.cycles()
        spread = math.exp(Z90 * math.sqrt(self._variance(bottle, mean, floor, expected)))
        return CyclesLeft(
            expected=expected,
            low=expected / spread,
            high=min(expected * spread, max(expected, mean[X] / _min_cost_kPa(self._p))),
            measured_cycles=self.measured_cycles,
            cost_kPa=forecast.cost_kPa(),
            floor_kPa=floor.kPa,
        )

    def _floor(self, mean: Sequence[float]) -> _Floor:
        """The supply below which the hardest recent inflation is no longer completed in time."""
        inflations = self._inflations or [self._assumed_inflation()]
        kappa = math.exp(self._demand.ln)
        worst = max(inflations, key=lambda i: self._air_kPa(mean, i) / i.given_s)
        air = self._air_kPa(mean, worst)
        kPa = min_supply_kPa(self._belief, worst, air, kappa * air)
        if worst.spent.venturi_s > VENTURI_USED_S and kPa < self._p.venturi_least_supply_kPa:
            air = mean[RISE] * worst.swing_kPa + FLAT_COUNTED * mean[FLAT] * worst.spent.flat
            kPa = min_supply_kPa(self._belief, worst, air, kappa * air)
        # An equally hard inflation that was completed with a lower supply is an upper bound of the floor.
        proven = [i.supply_kPa_abs for i in inflations if i.reached and i.as_hard_as(worst)]
        kPa = min([kPa, *(supply - AMBIENT_KPA for supply in proven)])
        more_kPa = min_supply_kPa(self._belief, worst, air * 1.1, kappa * air * 1.1)
        return _Floor(kPa, (more_kPa - kPa) / math.log(1.1), worst, air)

    def _variance(self, bottle: Bottle, mean: Sequence[float], floor: _Floor, expected: float) -> float:
        """Variance of ln n, from all uncertain numbers."""
        jacobian = [self._derivative(bottle, mean, floor, i) for i in range(SIZE)]
        variance = sum(
            jacobian[i] * jacobian[k] * bottle.covariance[i][k] for i in range(SIZE) for k in range(SIZE)
        )
        floor_sd = math.hypot(
            self._belief.zero_sd_kPa,
            REGULATOR_SD * (floor.kPa + AMBIENT_KPA),
            floor.kPa_per_ln * math.sqrt(self._demand.variance),
        )
        for forecast in (
            _Forecast(self._belief, self._mix, mean, floor.kPa + floor_sd),
            _Forecast(self._belief, self._mix, mean, floor.kPa, trend=VENTURI_TREND + VENTURI_TREND_SD),
            _Forecast(self._belief, self._mix, mean, floor.kPa, flat_counted=0.0),
        ):
            variance += math.log(forecast.cycles() / expected) ** 2
        unflown = UNFLOWN_SD * self._mix.assumed_share
        return variance + unflown**2 + MODEL_SD**2 + (COUNT_SD / max(COUNT_SD, expected)) ** 2

    def _derivative(self, bottle: Bottle, mean: Sequence[float], floor: _Floor, i: int) -> float:
        """The derivative of ln n with respect to state i of the reservoir."""
        half_sd = 0.5 * math.sqrt(bottle.covariance[i][i])
        ends = []
        for end in (-half_sd, half_sd):
            moved = list(mean)
            moved[i] += end
            if RISE <= i < WARMTH:
                moved[i] = max(0.0, moved[i])
            kPa = floor.kPa
            if i in (RISE, FLAT) and floor.air_kPa > 0.0:
                kPa += floor.kPa_per_ln * (self._air_kPa(moved, floor.worst) / floor.air_kPa - 1.0)
            ends.append((moved[i], math.log(_Forecast(self._belief, self._mix, moved, kPa).cycles())))
        (a, ln_a), (b, ln_b) = ends
        return (ln_b - ln_a) / (b - a) if b > a else 0.0

    def _assumed_inflation(self) -> ObservedInflation:
        """The cycle of `[pneumatics]`, used before the first flown one: a linear rise and a short hold."""
        swing = self._p.cycle_swing_kPa
        return ObservedInflation(
            low_kPa=0.0,
            top_kPa=swing,
            given_s=1.2 * swing / self._p.cycle_rate_kPa_per_s,
            valve_kPa_s=0.0,
            partly=1.0,
            supply_kPa_abs=self._p.full_kPa + AMBIENT_KPA,
            reached=True,
            setpoints_kPa=tuple(min(swing, 1.2 * swing * (i + 0.5) / TRACE) for i in range(TRACE)),
            spent=self._mix.per_cycle(),
        )


def _min_cost_kPa(p: PneumaticsConfig) -> float:
    """Lower bound of a cycle's cost: a fifth of that of a rigid CV with the configured volume."""
    return 0.2 * p.cv_volume_L * p.cycle_swing_kPa / p.reservoir_volume_L


class _Floor(NamedTuple):
    """The minimum supply (gauge) for cycles."""

    kPa: float
    kPa_per_ln: float
    """Its derivative with respect to ln(air of the inflation)."""
    worst: ObservedInflation
    """The inflation that needs it."""
    air_kPa: float


class _Cost(NamedTuple):
    """Cost of a cycle at pressure x: fixed + per_kPa · x."""

    fixed_kPa: float
    per_kPa: float

    def at(self, x_kPa: float) -> float:
        return self.fixed_kPa + self.per_kPa * max(0.0, x_kPa)

    def cycles(self, from_kPa: float, to_kPa: float) -> float:
        """The number of cycles from one pressure down to another."""
        fall = from_kPa - to_kPa
        if self.per_kPa * fall < 1e-6 * self.fixed_kPa:
            return fall / self.fixed_kPa
        return math.log(self.at(from_kPa) / self.at(to_kPa)) / self.per_kPa


class _Forecast:
    """The cost of a cycle as flown at present, and the number of cycles down to a floor."""

    def __init__(
        self,
        belief: Belief,
        mix: _Mix,
        mean: Sequence[float],
        floor_kPa: float,
        trend: float = VENTURI_TREND,
        flat_counted: float = FLAT_COUNTED,
    ) -> None:
        cycle, p = mix.per_cycle(), belief.pneumatics
        self._belief = belief
        self._x = mean[X]
        self._floor = floor_kPa
        self._time_s = cycle.time_s
        self._volume_L = p.reservoir_volume_L
        self._warmth = math.exp(mean[WARMTH])
        with_venturi = cycle.venturi_s > VENTURI_USED_S
        self._venturi_stops = p.venturi_least_supply_kPa if with_venturi else 0.0
        min_kPa = _min_cost_kPa(p)
        rigid = max(min_kPa, mean[RISE] * cycle.rise_kPa + mean[CV_LEAK] * cycle.held_kPa_s)
        leak = mean[LEAK] * cycle.time_s
        flat = mean[FLAT] * cycle.flat
        self._without = _Cost(rigid + (flat_counted if with_venturi else 1.0) * flat, leak)
        slope = mean[VENTURI] * cycle.venturi_s * (1.0 - trend)
        venturi = mean[VENTURI] * mix.venturi_kPa_s() - slope * mix.venturi_supply_kPa()
        self._with = _Cost(max(min_kPa, rigid + flat + venturi), leak + slope)

    def cost_kPa(self) -> float:
        return (self._with if self._x > self._venturi_stops else self._without).at(self._x)

    def cycles(self) -> float:
        end = self._floor
        # At the end the gas is cold from the present rate of cycles: correct the pressure for it.
        heat_W = self._volume_L * self._without.at(end) / max(0.1, self._time_s)
        colder = colder_K(self._belief, heat_W, end + AMBIENT_KPA, self._warmth)
        end += (end + AMBIENT_KPA) / STANDARD_TEMPERATURE_K * colder
        if self._x <= end:
            return MIN_CYCLES
        stops = min(max(self._venturi_stops, end), self._x)
        return MIN_CYCLES + self._with.cycles(self._x, stops) + self._without.cycles(stops, end)
