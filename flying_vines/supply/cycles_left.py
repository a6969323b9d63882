"""The air left, and for how many cycles it is enough: learned in flight.

One cycle costs A + B x kPa at reservoir pressure x. A: air for the inflation. B x: leak during one cycle at
the present rate of cycles, and the Venturi. From the present pressure x₀ down to x₁, below which the
reservoir no longer fills the control volume (CV) in time, this gives

    n = ∫ dx / (A + B x) = ln((A + B x₀) / (A + B x₁)) / B

cycles. If the Venturi is off below some pressure, n has two parts. The uncertainty of all these numbers gives
the interval of ln n. Pouch: the bending pouch of the actuator.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from flying_vines.config.config import PneumaticsConfig
from flying_vines.physics import paper
from flying_vines.physics.gas import STANDARD_TEMPERATURE_K
from flying_vines.supply.air_use import TRACE, AirUse, ObservedInflation
from flying_vines.supply.min_supply import SupplyCost, fillable, min_supply_kPa
from flying_vines.supply.reservoir_filter import (
    CV_LEAK,
    FLAT,
    LEAK,
    RISE,
    SIZE,
    VENTURI,
    WARMTH,
    Rates,
    ReservoirFilter,
    Spent,
    X,
    colder_K,
)
from flying_vines.supply.rig_prior import AMBIENT_KPA, RigPrior
from flying_vines.supply.telemetry_features import Features

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
"""At low supply the Venturi is off, and the pouch does not go flat between cycles. Then air that
fills a flat pouch is not needed, but air that stretches the pouch is. The estimate cannot tell them apart. So
it counts half of the additional air of an inflation."""
VENTURI_USED_S = 0.01
"""A shorter Venturi time in a cycle counts as none."""
VENTURI_TREND = 0.3
"""Growth of the Venturi's time as its supply falls. 0: constant time. 1: constant air per cycle."""
VENTURI_TREND_SD = 0.35
RHYTHM_SD = 0.25
"""Relative standard deviation of the time of a cycle. It matters if there is a leak."""
MEMORY_CYCLES = 15.0
"""Averaging length over flown cycles."""
PRIOR_CYCLES = 0.05
"""Weight of the assumed cycle, in flown cycles."""
RECENT_INFLATIONS = 10
SURE_SHARE = 0.75
"""The share of the learned air that a bend surely uses, in addition to `SURE_SDS` of its uncertainty."""
SURE_SDS = 2.0
MAX_PAUSE_S = 30.0
"""The rest of a longer pause is a wait, not part of the rhythm. `CyclesLeft.minutes` has its cost."""
LONG_PAUSE = 4.0
"""A pause of this many times the usual one is a wait, too, if it is longer than `SHORT_PAUSE_S`."""
SHORT_PAUSE_S = 5.0
MAX_MINUTES = 600.0
"""Longer times are not distinguished."""
Z90 = 1.645


@dataclass(frozen=True, slots=True)
class CyclesLeft:
    """A prediction with its 90 % interval, and its basis."""

    expected: float
    low: float
    high: float
    measured_cycles: float
    """The number of flown cycles from which `cost_kPa` was learned."""
    cost_kPa: float
    """The expected cost of one cycle at the present pressure, in kPa of the reservoir."""
    floor_kPa: float
    """The expected gauge pressure of the reservoir below which cycles are not completed in time."""
    bend_kPa: float
    """The swing of the last bend; before the first bend, the swing of a cycle of `[pneumatics]`."""
    per_cycle: float
    """The number of bends like the last one, in the present rhythm, that take the air of one cycle."""
    minutes: float
    """Time until the floor without another bend, at the present loss; at most `MAX_MINUTES`."""
    minutes_low: float
    minutes_high: float
    lost: bool = False
    """A fault that loses air is latched: nothing is left until a person clears it."""

    def __str__(self) -> str:
        return f"{self.expected:.0f} cycles left ({self.low:.0f}-{self.high:.0f})"


class AirNeeded(NamedTuple):
    """The reservoir pressure that a motion needs."""

    spending_kPa: float
    """The expected fall of the reservoir's pressure."""
    floor_kPa: float
    """Minimum difference between reservoir and vine for the requested rate."""


class MixSums(NamedTuple):
    """The sums of `_Mix`, to store them."""

    cycles: float
    assumed_cycles: float
    amounts: tuple[float, ...]
    venturi_kPa_s: float


class MeanCycle(NamedTuple):
    """The average of the flown cycles."""

    spent: Spent
    venturi_kPa_s: float
    """Gauge supply plus ambient, integrated while the Venturi's valve was open."""
    venturi_supply_kPa: float
    """Mean gauge supply while the Venturi's valve was open."""
    assumed_share: float
    """The share of the assumed cycle, which was not flown."""


class Basis(NamedTuple):
    """All numbers behind a prediction."""

    mean: Sequence[float]
    cycle: MeanCycle
    floor_kPa: float


@dataclass(frozen=True, slots=True)
class Learned:
    """The numbers that a run learned about a rig. They are stored for the next run."""

    rates: Rates
    demand_ln: float
    """ln κ of `min_supply`."""
    demand_variance: float
    mix: MixSums
    inflations: tuple[ObservedInflation, ...]
    measured_cycles: float


class _Mix:
    """The average of the flown cycles: sums in which older cycles count less."""

    def __init__(self, prior: RigPrior) -> None:
        p = prior.pneumatics
        self._cycle_kPa = p.cycle_swing_kPa
        self.cycles = self._assumed_cycles = PRIOR_CYCLES
        time_s = 2.0 * p.cycle_swing_kPa / p.cycle_rate_kPa_per_s
        held = 0.5 * p.cycle_swing_kPa * time_s
        cycle = (time_s, prior.cycle_rise_kPa, 1.0, prior.cycle_venturi_s, held)
        self._sums = [PRIOR_CYCLES * amount for amount in cycle]
        self._venturi_kPa_s = PRIOR_CYCLES * prior.cycle_venturi_s * (p.full_kPa + AMBIENT_KPA)
        self._pause_s: float | None = None
        """The usual pause between two inflations, averaged over about ten."""

    @property
    def sums(self) -> MixSums:
        return MixSums(self.cycles, self._assumed_cycles, tuple(self._sums), self._venturi_kPa_s)

    @sums.setter
    def sums(self, sums: MixSums) -> None:
        self.cycles, self._assumed_cycles, amounts, self._venturi_kPa_s = sums
        self._sums = list(amounts)

    def add(self, inflation: ObservedInflation, supply_kPa_abs: float) -> None:
        cycles = inflation.swing_kPa / self._cycle_kPa
        keep = math.exp(-cycles / MEMORY_CYCLES)
        self.cycles = keep * self.cycles + cycles
        self._assumed_cycles *= keep
        whole_s = max(0.0, inflation.spent.time_s - inflation.given_s)
        pause_s = counted_s = min(MAX_PAUSE_S, whole_s)
        if self._pause_s is not None and whole_s > max(SHORT_PAUSE_S, LONG_PAUSE * self._pause_s):
            counted_s = self._pause_s
        self._pause_s = pause_s if self._pause_s is None else 0.9 * self._pause_s + 0.1 * pause_s
        waited_s = whole_s - counted_s
        spent = inflation.spent._replace(time_s=inflation.spent.time_s - waited_s)
        self._sums = [keep * a + b for a, b in zip(self._sums, spent, strict=True)]
        self._venturi_kPa_s = keep * self._venturi_kPa_s + inflation.spent.venturi_s * supply_kPa_abs

    def mean(self) -> MeanCycle:
        return MeanCycle(
            Spent(*(amount / self.cycles for amount in self._sums)),
            self._venturi_kPa_s / self.cycles,
            self._venturi_kPa_s / max(1e-9, self._sums[3]) - AMBIENT_KPA,
            self._assumed_cycles / self.cycles,
        )


class ReservoirEstimate:
    """Learns from telemetry the cost of a cycle, the leaks, and the minimum pressure for a cycle.

    `learned` has the numbers of an earlier run of the same rig.
    """

    def __init__(self, prior: RigPrior, learned: Learned | None = None) -> None:
        self._prior = prior
        self._p = prior.pneumatics
        self.reservoir_kPa = math.nan
        """Smoothed reading, with the sensor's gain and offset corrected; NaN before the first one."""
        self.read_at = 0.0
        self._use = AirUse(prior)
        self.filter: ReservoirFilter | None = None
        self._rates = learned.rates if learned else None
        self._demand = SupplyCost(prior)
        self._mix = _Mix(prior)
        self._inflations: list[ObservedInflation] = []
        self.sure_use_kPa = 0.0
        """The air that the bends so far have surely used, as learned. It only grows."""
        self._known: deque[Rates] = deque(maxlen=RECENT_INFLATIONS)
        """What was learned before each of the last bends. So a sensor that begins to be wrong does not teach
        at once that bends use no air."""
        self._warmed_up = False
        self.measured_cycles = 0.0
        """The number of flown cycles from which the cost was learned."""
        self.basis: Basis | None = None
        """The basis of the latest prediction."""
        self._cycle_kPa = math.nan
        """The cost of one cycle, computed at each block, before a decision needs it; NaN at first."""
        if learned:
            self._demand.ln, self._demand.variance = learned.demand_ln, learned.demand_variance
            self._mix.sums = learned.mix
            self._inflations = list(learned.inflations)
            self.measured_cycles = learned.measured_cycles

    @property
    def learned(self) -> Learned | None:
        """The numbers for the next run; None before the first reading."""
        if self.filter is None:
            return None
        return Learned(
            rates=self.filter.rates,
            demand_ln=self._demand.ln,
            demand_variance=self._demand.variance,
            mix=self._mix.sums,
            inflations=tuple(self._inflations),
            measured_cycles=self.measured_cycles,
        )

    def update(self, features: Features) -> None:
        """Take in one telemetry message."""
        if features.reservoir_kPa is not None:
            self.read_at = features.t
        if features.reservoir_smooth_kPa is not None:
            self.reservoir_kPa = features.reservoir_smooth_kPa
        if not features.complete:
            return
        use = self._use
        use.take(features, self.reservoir_kPa)
        if use.reading_kPa is not None and self.filter is None:
            self.filter = ReservoirFilter(self._prior, use.reading_kPa, self._rates)
        if self.filter is None:
            return
        if use.was_cut_off:
            mean = self.filter.mean
            self.filter.doubt(abs(mean[RISE]) * self._p.cycle_swing_kPa + abs(mean[FLAT]))
        if use.block is not None:
            self.filter.spend(use.block, use.unseen_s)
            if use.reading_kPa is not None:
                self.filter.read(use.reading_kPa, READING_SD_KPA / math.sqrt(use.readings))
        if use.inflation is not None:
            self._add(use.inflation, self.filter)
        if use.block is not None or use.inflation is not None:
            self._cycle_kPa = self._cost_kPa(self.filter)

    @property
    def rose_kPa(self) -> float:
        """A sudden rise of the pressure that `ReportedCycles` has not reported yet."""
        return max(0.0, self.filter.jumped_kPa) if self.filter else 0.0

    def cut_off(self) -> None:
        """The present movement is replaced before its end: nothing is learned from this movement."""
        self._use.cut_off()

    def restart(self) -> None:
        """Forget the air that a bend takes, and the leaks: vine or reservoir were repaired or exchanged."""
        self._use.cut_off()
        self.filter = self._rates = None
        self._known.clear()
        self._cycle_kPa = math.nan
        self.measured_cycles = 0.0
        self._warmed_up = False

    def _add(self, inflation: ObservedInflation, air: ReservoirFilter) -> None:
        if inflation.cut_off:
            return
        self._known.append(air.rates)
        self.sure_use_kPa += max(_sure_kPa(known, inflation.spent) for known in self._known)
        if self._prior.packed_kPa > 0.0 and not self._warmed_up:
            # The pouch was packed flat, so the first cycle differs from all later ones.
            self._warmed_up = True
            return
        self.measured_cycles += inflation.swing_kPa / self._p.cycle_swing_kPa
        self._mix.add(inflation, air.absolute_kPa)
        air_kPa = self._air_kPa(air.possible_mean(), inflation)
        self._demand.learn(inflation, air_kPa)
        if not fillable(self._prior, inflation, math.exp(self._demand.ln) * air_kPa):
            return  # the setpoint fell before any supply could have filled the vine
        self._inflations = [*self._inflations[1 - RECENT_INFLATIONS :], inflation]

    @staticmethod
    def _air_kPa(mean: Sequence[float], inflation: ObservedInflation) -> float:
        return mean[RISE] * inflation.swing_kPa + mean[FLAT] * inflation.spent.flat

    def air_needed(self, rise_kPa: float, rate_kPa_per_s: float) -> AirNeeded:
        """The air to raise the CV by `rise_kPa` in total, and the supply that `rate_kPa_per_s` needs."""
        p = self._p
        floor_kPa = paper.min_reservoir_kPa(rate_kPa_per_s, p.evp_flow_resistance_kPa_s_per_SL, p.cv_volume_L)
        return AirNeeded(self.spending_kPa(rise_kPa), floor_kPa)

    def spending_kPa(self, rise_kPa: float) -> float:
        if self.filter is None:
            return 2.0 * self._p.cv_volume_L * rise_kPa / self._p.reservoir_volume_L
        if math.isnan(self._cycle_kPa):
            self._cycle_kPa = self._cost_kPa(self.filter)
        return self._cycle_kPa * (rise_kPa / self._p.cycle_swing_kPa)

    def _cost_kPa(self, air: ReservoirFilter) -> float:
        """The expected cost of one cycle now."""
        basis = Basis(air.possible_mean(), self._mix.mean(), 0.0)
        return _Forecast(self._prior, basis).cost_kPa()

    def cycles_left(self) -> CyclesLeft | None:
        """None before the first reading."""
        return None if self.filter is None else self._predict(self.filter)

    def cycles_of(self, basis: Basis) -> float:
        """The cycles left with these numbers."""
        return _Forecast(self._prior, basis).cycles()

    def _predict(self, air: ReservoirFilter) -> CyclesLeft:
        mean = air.possible_mean()
        floor = self._floor(mean)
        basis = self.basis = Basis(mean, self._mix.mean(), floor.kPa)
        forecast = _Forecast(self._prior, basis)
        expected = forecast.cycles()
        spread = math.exp(Z90 * math.sqrt(self._variance(air, basis, floor, expected)))
        leak_sd = math.sqrt(air.covariance[LEAK][LEAK])
        cost_kPa = forecast.cost_kPa()
        return CyclesLeft(
            expected=expected,
            low=expected / spread,
            high=min(expected * spread, max(expected, mean[X] / _min_cost_kPa(self._p))),
            bend_kPa=self._inflations[-1].swing_kPa if self._inflations else self._p.cycle_swing_kPa,
            per_cycle=self._last_bends_per_cycle(mean, cost_kPa),
            minutes=self._minutes(mean, mean[LEAK], floor.kPa),
            minutes_low=self._minutes(mean, mean[LEAK] + Z90 * leak_sd, floor.kPa),
            minutes_high=self._minutes(mean, mean[LEAK] - Z90 * leak_sd, floor.kPa),
            measured_cycles=self.measured_cycles,
            cost_kPa=cost_kPa,
            floor_kPa=floor.kPa,
        )

    def _last_bends_per_cycle(self, mean: Sequence[float], cost_kPa: float) -> float:
        if not self._inflations:
            return 1.0
        last = self._inflations[-1]
        share = last.swing_kPa / self._p.cycle_swing_kPa
        time_s = share * self._mix.mean().spent.time_s
        air_kPa = self._air_kPa(mean, last) + mean[LEAK] * time_s * max(0.0, mean[X])
        air_kPa += mean[VENTURI] * last.spent.venturi_s * (mean[X] + AMBIENT_KPA)
        air_kPa += mean[CV_LEAK] * last.spent.held_kPa_s
        return cost_kPa / max(share * _min_cost_kPa(self._p), air_kPa)

    def _minutes(self, mean: Sequence[float], leak_per_s: float, floor_kPa: float) -> float:
        """Time until the floor, at this leak and the present pressure of the vine."""
        floor_kPa = max(0.0, floor_kPa)
        if mean[X] <= floor_kPa:
            return 0.0
        leak_per_s = max(leak_per_s, 1e-9)
        held = mean[CV_LEAK] * max(0.0, self._use.cv_kPa) / leak_per_s
        seconds = math.log((mean[X] + held) / (floor_kPa + held + 1e-6)) / leak_per_s
        return min(MAX_MINUTES, seconds / 60.0)

    def _floor(self, mean: Sequence[float]) -> _Floor:
        """The supply below which the hardest recent inflation is no longer completed in time."""
        inflations = self._inflations or [self._assumed_inflation()]
        kappa = math.exp(self._demand.ln)
        worst = max(inflations, key=lambda i: self._air_kPa(mean, i) / i.given_s)
        air = self._air_kPa(mean, worst)
        kPa = min_supply_kPa(self._prior, worst, air, kappa * air)
        if worst.spent.venturi_s > VENTURI_USED_S and kPa < self._p.venturi_least_supply_kPa:
            air = mean[RISE] * worst.swing_kPa + FLAT_COUNTED * mean[FLAT] * worst.spent.flat
            kPa = min_supply_kPa(self._prior, worst, air, kappa * air)
        # The lowest supply that completed an equally hard inflation is an upper bound of the floor.
        proven = [i.supply_kPa_abs for i in inflations if i.reached and i.as_hard_as(worst)]
        kPa = min([kPa, *(supply - AMBIENT_KPA for supply in proven)])
        more_kPa = min_supply_kPa(self._prior, worst, air * 1.1, kappa * air * 1.1)
        return _Floor(kPa, (more_kPa - kPa) / math.log(1.1), worst, air)

    def _variance(self, air: ReservoirFilter, basis: Basis, floor: _Floor, expected: float) -> float:
        """Variance of ln n, from all uncertain numbers."""
        jacobian = [self._derivative(air, basis, floor, i) for i in range(SIZE)]
        variance = sum(
            jacobian[i] * jacobian[k] * air.covariance[i][k] for i in range(SIZE) for k in range(SIZE)
        )
        floor_sd = math.hypot(
            self._prior.zero_sd_kPa,
            REGULATOR_SD * (floor.kPa + AMBIENT_KPA),
            floor.kPa_per_ln * math.sqrt(self._demand.variance),
        )
        spent = basis.cycle.spent
        slower = basis.cycle._replace(spent=spent._replace(time_s=(1.0 + RHYTHM_SD) * spent.time_s))
        for forecast in (
            _Forecast(self._prior, basis._replace(floor_kPa=floor.kPa + floor_sd)),
            _Forecast(self._prior, basis, trend=VENTURI_TREND + VENTURI_TREND_SD),
            _Forecast(self._prior, basis, flat_counted=0.0),
            _Forecast(self._prior, basis._replace(cycle=slower)),
        ):
            variance += math.log(forecast.cycles() / expected) ** 2
        unflown = UNFLOWN_SD * basis.cycle.assumed_share
        return variance + unflown**2 + MODEL_SD**2 + (COUNT_SD / max(COUNT_SD, expected)) ** 2

    def _derivative(self, air: ReservoirFilter, basis: Basis, floor: _Floor, i: int) -> float:
        """The derivative of ln n with respect to state i of the reservoir."""
        half_sd = 0.5 * math.sqrt(air.covariance[i][i])
        ends = []
        for end in (-half_sd, half_sd):
            moved = list(basis.mean)
            moved[i] += end
            if RISE <= i < WARMTH:
                moved[i] = max(0.0, moved[i])
            kPa = floor.kPa
            if i in (RISE, FLAT) and floor.air_kPa > 0.0:
                kPa += floor.kPa_per_ln * (self._air_kPa(moved, floor.worst) / floor.air_kPa - 1.0)
            ends.append((moved[i], math.log(self.cycles_of(Basis(moved, basis.cycle, kPa)))))
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
            spent=self._mix.mean().spent,
        )


def _sure_kPa(known: Rates, spent: Spent) -> float:
    """Lower bound of the air that an inflation has used."""
    amounts = (spent.rise_kPa, spent.flat)
    mean = sum(rate * amount for rate, amount in zip(known.mean, amounts, strict=False))
    variance = sum(
        known.covariance[i][k] * a * b for i, a in enumerate(amounts) for k, b in enumerate(amounts)
    )
    return max(0.0, SURE_SHARE * (mean - SURE_SDS * math.sqrt(max(0.0, variance))))


def _min_cost_kPa(p: PneumaticsConfig) -> float:
    """Lower bound of a cycle's cost: a fifth of that of a rigid CV with the configured volume."""
    return 0.2 * p.cv_volume_L * p.cycle_swing_kPa / p.reservoir_volume_L


class _Floor(NamedTuple):
    """The minimum supply (gauge) for cycles."""

    kPa: float
    kPa_per_ln: float
    """Derivative of `kPa` with respect to ln(air of the inflation)."""
    worst: ObservedInflation
    """The inflation that needs this supply."""
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
        prior: RigPrior,
        basis: Basis,
        trend: float = VENTURI_TREND,
        flat_counted: float = FLAT_COUNTED,
    ) -> None:
        mean, mix, p = basis.mean, basis.cycle, prior.pneumatics
        cycle = mix.spent
        self._prior = prior
        self._x = mean[X]
        self._floor = basis.floor_kPa
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
        venturi = mean[VENTURI] * mix.venturi_kPa_s - slope * mix.venturi_supply_kPa
        self._with = _Cost(max(min_kPa, rigid + flat + venturi), leak + slope)

    def cost_kPa(self) -> float:
        return (self._with if self._x > self._venturi_stops else self._without).at(self._x)

    def cycles(self) -> float:
        end = self._floor
        # The floor is a pressure of gas that the cycles have cooled. Convert it to ambient temperature, as x.
        heat_W = self._volume_L * self._without.at(end) / max(0.1, self._time_s)
        colder = colder_K(self._prior, heat_W, end + AMBIENT_KPA, self._warmth)
        end += (end + AMBIENT_KPA) / STANDARD_TEMPERATURE_K * colder
        if self._x <= end:
            return MIN_CYCLES
        stops = min(max(self._venturi_stops, end), self._x)
        return MIN_CYCLES + self._with.cycles(self._x, stops) + self._without.cycles(stops, end)
