"""Every effect by name: its place in the equations, its strength on real rigs, and its weaker form.

A clear strength is drawn log-uniformly from the range of real rigs, as far as this is known:

- leaks: a reservoir that loses 0.5 to 10 kPa/s, a vine that halves its pressure in a fraction of a second to
  seconds; a viscous leak loses as much as a leak by Ohm's law at 500 kPa in a reservoir, at 35 kPa in a vine;
- flow: critical ratios 0.2 to 0.5 of valves with fittings; resistances that are off by 8 to 40 % (the paper's
  by 15 %);
- heat: a reservoir settles in about 10 s, half a litre of cloth or plastic within seconds;
- volumes: tubing and fittings of 8 to 40 % of the CV; another reservoir, or one with water in it, 5 to 25 %;
- valves: hysteresis 10 % nominally, a spring's preload of a quarter to half the current, poppets of 5 to 20
  ms with drivers and loops of 30 to 90 ms, a solenoid with a fly-back diode 10 to 80 ms;
- sensors: total error band 3 kPa for the CV, 22 kPa for the reservoir; ratiometric gains of a few percent,
  like the supply;
- ambient: 2.5 to 15 m/s of climb at 0.012 kPa/m.

A weaker effect has a share of the departure from the baseline. For a critical ratio this is not defined,
because no ratio gives Ohm's law, so `compressible_flow` is clear or absent. For `venturi_stall` the departure
is the distance above 250 kPa, because rigs hardly fly with less.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from numpy.random import Generator

from hidden_truth.kernel import Physics
from hidden_truth.rig import Rig, physics

Apply = Callable[[Physics, float], Physics]
Weaken = Callable[[float, float], float]

_STALL_FROM_KPA = 250.0


def _less(value: float, share: float) -> float:
    return value * share


def _larger(resistance: float, share: float) -> float:
    return resistance / share


def _nearer_one(value: float, share: float) -> float:
    return 1.0 + (value - 1.0) * share


def _lower_stall(value: float, share: float) -> float:
    return _STALL_FROM_KPA + (value - _STALL_FROM_KPA) * share


def _higher_ceiling(value: float, share: float) -> float:
    return value / share


@dataclass(frozen=True)
class Effect:
    """`low` and `high` bound the clear strength; for a scale or a gain they are distances from one."""

    name: str
    parameter: str
    low: float
    high: float
    apply: Apply
    weaken: Weaken | None = _less
    either_sign: bool = False
    per_cv_litre: bool = False
    seen_without_cv: bool = False

    def draw(self, rng: Generator, rig: Rig) -> float:
        """A clear strength."""
        size = math.exp(rng.uniform(math.log(self.low), math.log(self.high)))
        return self.value(-size if self.either_sign and rng.random() < 0.5 else size, rig)

    def value(self, size: float, rig: Rig) -> float:
        """The parameter's value for a strength of this size."""
        if self.per_cv_litre and rig.cv_L is not None:
            size *= rig.cv_L
        return 1.0 + size if self.weaken is _nearer_one else size

    @property
    def in_table(self) -> bool:
        return not self.name.startswith("x_")


def _set(field: str) -> Apply:
    return lambda p, value: p._replace(**{field: value})


def _times(field: str) -> Apply:
    return lambda p, value: p._replace(**{field: getattr(p, field) * value})


RESISTANCE, TIME, SCALE = "flow_resistance_kPa_s_per_SL", "time_constant_s", "scale"
VISCOUS = "conductance_constant_kPa2_s_per_SL"

_ALL = (
    Effect(
        "reservoir_leak",
        RESISTANCE,
        3_000.0,
        20_000.0,
        lambda p, value: p._replace(reservoir_leak_SL_per_s_kPa=1.0 / value),
        _larger,
        seen_without_cv=True,
    ),
    Effect(
        "cv_leak",
        RESISTANCE,
        200.0,
        1_500.0,
        lambda p, value: p._replace(cv_leak_SL_per_s_kPa=1.0 / value),
        _larger,
    ),
    Effect(
        "compressible_flow",
        "critical_pressure_ratio",
        0.2,
        0.5,
        _set("critical_pressure_ratio"),
        None,
        seen_without_cv=True,
    ),
    Effect("reservoir_cooling", TIME, 4.0, 20.0, _set("reservoir_wall_s"), seen_without_cv=True),
    Effect("cv_heating", TIME, 0.5, 8.0, _set("cv_wall_s")),
    Effect("cv_compliance", "per_kPa", 0.002, 0.015, _set("compliance_per_kPa")),
    Effect(
        "dead_volume",
        "volume_L",
        0.08,
        0.4,
        lambda p, value: p._replace(cv_L=p.cv_L + value),
        per_cv_litre=True,
    ),
    Effect(
        "reservoir_volume",
        SCALE,
        0.05,
        0.25,
        _times("reservoir_L"),
        _nearer_one,
        either_sign=True,
        seen_without_cv=True,
    ),
    Effect(
        "evp_restriction",
        SCALE,
        0.08,
        0.4,
        _times("evp_kPa_s_per_SL"),
        _nearer_one,
        either_sign=True,
        seen_without_cv=True,
    ),
    Effect("evp_dead_zone", "opening", 0.1, 0.45, _set("dead_zone")),
    Effect("evp_hysteresis", "width", 0.05, 0.2, _set("play")),
    Effect("evp_lag", TIME, 0.005, 0.06, _set("evp_lag_s")),
    Effect("line_delay", "delay_s", 0.01, 0.09, _set("evp_delay_s")),
    Effect("solenoid_slow_close", "delay_s", 0.01, 0.08, _set("closing_s")),
    Effect("venturi_stall", "supply_pressure_kPa", 350.0, 550.0, _set("stall_kPa"), _lower_stall),
    Effect("cv_sensor_lag", TIME, 0.01, 0.08, _set("cv_sensor_lag_s")),
    Effect("cv_sensor_offset", "offset_kPa", 0.6, 4.0, _set("cv_offset_kPa"), either_sign=True),
    Effect("cv_sensor_gain", "gain", 0.02, 0.08, _set("cv_gain"), _nearer_one, either_sign=True),
    Effect(
        "reservoir_sensor_offset",
        "offset_kPa",
        5.0,
        25.0,
        _set("reservoir_offset_kPa"),
        either_sign=True,
        seen_without_cv=True,
    ),
    Effect(
        "reservoir_sensor_gain",
        "gain",
        0.02,
        0.08,
        _set("reservoir_gain"),
        _nearer_one,
        either_sign=True,
        seen_without_cv=True,
    ),
    Effect(
        "ambient_drop",
        "rate_kPa_per_s",
        0.03,
        0.18,
        _set("ambient_drop_kPa_per_s"),
        seen_without_cv=True,
    ),
    Effect(
        "viscous_leak",
        VISCOUS,
        5e4,
        3.5e5,
        lambda p, value: p._replace(cv_viscous_leak_SL_per_s_kPa2=1.0 / value),
        _larger,
    ),
    Effect(
        "reservoir_viscous_leak",
        VISCOUS,
        2e6,
        1.4e7,
        lambda p, value: p._replace(reservoir_viscous_leak_SL_per_s_kPa2=1.0 / value),
        _larger,
        seen_without_cv=True,
    ),
    # Outside the table: resistance R (1 + k w), dw/dt = u − w/τ, of a coil that warms up while it is driven.
    Effect(
        "x_valve_heating",
        "per_s",
        0.01,
        0.05,
        lambda p, value: p._replace(coil_per_s=value, coil_cooling_s=25.0),
    ),
    # Flow ~ u^power; below one the valve opens early.
    Effect("x_evp_power", "power", 0.25, 1.0, _set("evp_power"), _nearer_one),
    # The opening is smaller by k (690 kPa − P_r): the supply pressure helps to lift the poppet.
    Effect("x_evp_lifting_force", "per_kPa", 1e-4, 4e-4, _set("opening_force_per_kPa")),
    # A check valve in the outlet opens at a pressure, and lowers the driving pressure by it.
    Effect("x_outlet_check_valve", "cracking_kPa", 2.0, 10.0, _set("cracking_kPa")),
    # The solenoid follows ISO 6358, matched at 69 kPa into 0 kPa.
    Effect("x_solenoid_choked", "critical_pressure_ratio", 0.2, 0.5, _set("outlet_critical_ratio"), None),
    # The solenoid opens late, or not at all if its command ends before.
    Effect("x_solenoid_slow_open", "delay_s", 0.01, 0.08, _set("opening_s")),
    # P_vac ~ min(1, P_r / rated)^power.
    Effect("x_venturi_power", "power", 0.6, 2.0, _set("vacuum_power"), _nearer_one),
    # A seam that opens above a pressure; the leak is proportional to the excess.
    Effect(
        "x_seam",
        RESISTANCE,
        100.0,
        600.0,
        lambda p, value: p._replace(relief_kPa=14.0, relief_kPa_s_per_SL=value),
        _larger,
    ),
    # A second chamber behind a restriction of 150 kPa s/SL.
    Effect(
        "x_second_chamber",
        "volume_L",
        0.1,
        0.5,
        lambda p, value: p._replace(second_L=value, second_kPa_s_per_SL=150.0),
        per_cv_litre=True,
    ),
    # The sensor sits at the valves: it reads the tube's drop, too.
    Effect("x_tube_drop", RESISTANCE, 4.0, 15.0, _set("tube_kPa_s_per_SL")),
    # The reservoir's sensor sits in the line, behind a resistance that all flow passes.
    Effect(
        "x_supply_line_drop", RESISTANCE, 20.0, 80.0, _set("supply_line_kPa_s_per_SL"), seen_without_cv=True
    ),
    # The CV sensor's zero settles as it warms up: D (1 − e^(−t / 12 s)) in each run.
    Effect(
        "x_sensor_drift",
        "drift_kPa",
        0.8,
        4.0,
        lambda p, value: p._replace(drift_kPa=value, drift_s=12.0),
        either_sign=True,
    ),
    # Vibration of the frame in the CV's line, sampled below its rate.
    Effect("x_vibration", "amplitude_kPa", 0.3, 1.5, lambda p, value: p._replace(hum_kPa=value, hum_Hz=43.7)),
    # The converter's range ends below the highest pressure of the CV.
    Effect("x_ceiling", "ceiling_kPa", 15.0, 40.0, _set("cv_ceiling_kPa"), _higher_ceiling),
    # A share of the samples repeats the previous readings of both sensors.
    Effect("x_repeats", "share", 0.03, 0.3, _set("repeat_share")),
)
EFFECTS = {effect.name: effect for effect in _ALL}
CAUSES = tuple(effect.name for effect in _ALL if effect.in_table)
OUTSIDE = tuple(effect.name for effect in _ALL if not effect.in_table)


@dataclass(frozen=True)
class Hidden:
    """An effect in one rig."""

    name: str
    value: float

    @property
    def effect(self) -> Effect:
        return EFFECTS[self.name]

    def weaker(self, share: float) -> Hidden:
        """This effect at a share of its strength."""
        weaken = self.effect.weaken
        if weaken is None:
            raise ValueError(f"{self.name} is present or absent: it cannot be weaker")
        return Hidden(self.name, weaken(self.value, share))


def with_effects(rig: Rig, hidden: Iterable[Hidden]) -> Physics:
    """The rig's equations with these effects, in any order; the kernel has a fixed order."""
    p = physics(rig)
    for one in hidden:
        p = one.effect.apply(p, one.value)
    return p
