"""Random rigs and random programs, for the benchmark of the cycles left.

A rig has assumed and true numbers. The estimate gets the assumed ones. `draw` has all distributions.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, replace

from flying_vines.config.config import PneumaticsConfig
from flying_vines.physics.plant.ambient import Steady
from flying_vines.physics.plant.effects import DVP, EVP, SOLENOID, Effects, likely_effects
from flying_vines.physics.plant.flow import Iso6358, Ohm
from flying_vines.physics.plant.plant import Plant
from flying_vines.physics.plant.sensors import HONEYWELL_15BAR, HONEYWELL_30PSI, Adc, Sensor
from flying_vines.physics.plant.valve_response import SolenoidTiming, ValveMotion
from flying_vines.physics.plant.volume import Compliant, Pouch, Shape, Wall
from flying_vines.physics.rig import ControlVolume, Hose, Reservoir, Rig
from flying_vines.simulation.phlosar.firmware import Tuning

HOST_TICK_S = 0.02
"""Time between setpoints, as in the service."""
NEVER_KPA = 1e9


@dataclass(frozen=True)
class Manoeuvre:
    """One inflation and deflation: the setpoint rises, stays, falls, rests."""

    low_kPa: float
    top_kPa: float
    rate_kPa_per_s: float
    """Rate of the ramps; with `sine`, the mean rate of the rise and of the fall."""
    hold_s: float
    rest_s: float
    sine: bool = False

    @property
    def swing_kPa(self) -> float:
        return self.top_kPa - self.low_kPa

    @property
    def steepest_kPa_per_s(self) -> float:
        return self.rate_kPa_per_s * (0.5 * math.pi if self.sine else 1.0)

    @property
    def ramp_s(self) -> float:
        return self.swing_kPa / self.rate_kPa_per_s

    @property
    def length_s(self) -> float:
        return 2.0 * self.ramp_s + self.hold_s + self.rest_s

    def setpoint_kPa(self, t_s: float) -> float:
        """The setpoint at `t_s`, counted from the start of the rise."""
        share = min(1.0, t_s / self.ramp_s)
        if t_s > self.ramp_s + self.hold_s:
            share = max(0.0, 1.0 - (t_s - self.ramp_s - self.hold_s) / self.ramp_s)
        if self.sine:
            share = 0.5 - 0.5 * math.cos(math.pi * share)
        return self.low_kPa + self.swing_kPa * share


@dataclass(frozen=True)
class Case:
    """A rig, its program, and its assumed numbers."""

    kind: str
    believed: PneumaticsConfig
    plant: Plant
    cv_sensor: Sensor
    reservoir_sensor: Sensor
    tuning: Tuning
    fill_kPa: float
    """True gauge pressure at the start."""
    waits_s: float
    """Time before the first inflation."""
    program: tuple[Manoeuvre, ...]
    """Repeated until the reservoir is too low for it."""
    seed: int


def draw(seed: int) -> Case:
    """One rig with its program and its flaws; the same seed gives the same rig."""
    dice = random.Random(f"cycles left {seed}")
    kind = dice.choice(("rigid", "compliant", "pouch"))
    believed_L = log_uniform(dice, 0.08, 0.4)
    swing_kPa = dice.uniform(12.0, 24.0)
    believed = PneumaticsConfig(
        reservoir_volume_L=dice.choice((1.0, 1.5, 2.0)),
        cv_volume_L=believed_L,
        cycle_swing_kPa=swing_kPa,
        cycle_rate_kPa_per_s=22.8,
    )
    reservoir_L = believed.reservoir_volume_L * dice.uniform(0.96, 1.04)
    cv_L = believed_L * min(1.5, max(0.65, dice.lognormvariate(0.0, 0.2)))
    shape: Shape | None = None
    if kind == "compliant":
        shape = Compliant(dice.uniform(0.002, 0.02))
    elif kind == "pouch":
        shape = Pouch(cv_L * dice.uniform(0.05, 0.3), dice.uniform(0.0, 0.006))
    rig = Rig(Reservoir(reservoir_L), ControlVolume(cv_L))
    return Case(
        kind=kind,
        believed=believed,
        plant=Plant(rig, _effects(dice, shape, reservoir_L, cv_L)),
        cv_sensor=_sensor(dice, HONEYWELL_30PSI, 1.0, 3.1, bits := dice.choice((10, 12))),
        reservoir_sensor=_sensor(dice, HONEYWELL_15BAR, 7.5, 22.5, bits),
        tuning=_tuning(dice),
        fill_kPa=dice.uniform(400.0, 690.0),
        waits_s=dice.uniform(3.0, 30.0),
        program=_program(dice, swing_kPa),
        seed=seed,
    )


def _tuning(dice: random.Random) -> Tuning:
    """A third of the rigs never use the Venturi, a third use it by the default settings, a third much more
    often."""
    venturi = dice.choice(("never", "as it is", "always"))
    if venturi == "never":
        return {"venturi_least_supply_kPa": NEVER_KPA}
    if venturi == "always":
        return {
            "active_error_kPa": dice.uniform(0.8, 2.0),
            "passive_error_kPa": dice.uniform(0.3, 0.8),
            "passive_first_s": dice.uniform(0.0, 0.02),
            "arrival_s": dice.uniform(0.01, 0.05),
        }
    return {}


def _effects(dice: random.Random, shape: Shape | None, reservoir_L: float, cv_L: float) -> Effects:
    """The effects of a real rig, each with random numbers."""
    likely = likely_effects()
    size = (reservoir_L / 2.0) ** (2.0 / 3.0)
    reservoir = Wall(
        conductance_W_per_K=size * dice.uniform(0.6, 1.5),
        capacity_J_per_K=size * dice.uniform(45.0, 84.0),
        outer_conductance_W_per_K=size * dice.uniform(0.5, 2.0),
    )
    cv_wall = Wall(
        conductance_W_per_K=0.3 * (cv_L / 0.1) ** (2.0 / 3.0) * dice.uniform(0.5, 2.0),
        capacity_J_per_K=20.0,
        outer_conductance_W_per_K=0.5,
    )
    return replace(
        likely,
        evp_law=_valve(dice, EVP, 0.85, 1.15),
        dvp_law=_valve(dice, DVP, 0.85, 1.15),
        solenoid_law=_valve(dice, SOLENOID, 0.6, 2.0),
        reservoir_wall=reservoir,
        cv_wall=cv_wall,
        evp_motion=_motion(dice, 0.005, 0.020),
        dvp_motion=_motion(dice, 0.010, 0.030),
        solenoid_timing=SolenoidTiming(dice.uniform(0.005, 0.02), dice.uniform(0.01, 0.04)),
        tubing=Hose(dice.uniform(0.005, 0.02), dice.uniform(3.0, 10.0)),
        cv_shape=shape,
        reservoir_leak=_leak(dice, 15_000.0, 200_000.0),
        cv_leak=_leak(dice, 4_000.0, 60_000.0),
        ambient=Steady(dice.uniform(84.0, 102.0), 273.15 + dice.uniform(-5.0, 40.0)),
    )


def _valve(dice: random.Random, law: Iso6358, least: float, most: float) -> Iso6358:
    return replace(
        law,
        sonic_conductance_SL_per_s_kPa=law.sonic_conductance_SL_per_s_kPa * dice.uniform(least, most),
        critical_pressure_ratio=dice.uniform(0.2, 0.45),
    )


def _motion(dice: random.Random, least_s: float, most_s: float) -> ValveMotion:
    return ValveMotion(
        delay_s=dice.uniform(0.001, 0.005),
        backlash_width=dice.uniform(0.0, 0.15),
        dead_opening=dice.uniform(0.2, 0.45),
        time_constant_s=dice.uniform(least_s, most_s),
    )


def _leak(dice: random.Random, least: float, most: float) -> Ohm | None:
    """A leak, in half of the rigs."""
    resistance = log_uniform(dice, least, most)
    return Ohm(resistance) if dice.random() < 0.5 else None


def _sensor(dice: random.Random, nominal: Sensor, offset_sd_kPa: float, most_kPa: float, bits: int) -> Sensor:
    return replace(
        nominal,
        noise_std_kPa=nominal.noise_std_kPa * dice.uniform(0.5, 1.5),
        offset_kPa=min(most_kPa, max(-most_kPa, dice.gauss(0.0, offset_sd_kPa))),
        gain=dice.gauss(1.0, 0.005),
        adc=Adc(bits),
    )


def _program(dice: random.Random, swing_kPa: float) -> tuple[Manoeuvre, ...]:
    """Bends, a wave, or both mixed; in bursts or evenly."""
    style = dice.choice(("bends", "wave", "mixed", "bursts"))
    if style == "bends":
        return (_bend(dice, swing_kPa),)
    if style == "wave":
        return (_wave(dice, swing_kPa, dice.uniform(0.0, 2.0)),)
    if style == "bursts":
        once = _wave(dice, swing_kPa, 0.0) if dice.random() < 0.5 else _bend(dice, swing_kPa)
        quick = replace(once, hold_s=min(once.hold_s, 0.5), rest_s=min(once.rest_s, 0.3))
        return (*[quick] * dice.randint(1, 3), replace(quick, rest_s=dice.uniform(5.0, 25.0)))
    mixed = [_bend(dice, swing_kPa)]
    for _ in range(dice.randint(1, 3)):
        part_kPa = swing_kPa * dice.uniform(0.3, 1.0)
        mixed.append(_wave(dice, part_kPa, 0.0) if dice.random() < 0.5 else _bend(dice, part_kPa))
    return tuple(mixed)


def _bend(dice: random.Random, top_kPa: float) -> Manoeuvre:
    return Manoeuvre(0.0, top_kPa, dice.uniform(15.0, 60.0), dice.uniform(0.3, 3.0), dice.uniform(0.3, 4.0))


def _wave(dice: random.Random, top_kPa: float, rest_s: float) -> Manoeuvre:
    low_kPa = dice.choice((0.0, 0.3 * top_kPa * dice.random()))
    frequency_Hz = dice.uniform(0.2, 0.6)
    rate_kPa_per_s = 2.0 * (top_kPa - low_kPa) * frequency_Hz
    return Manoeuvre(low_kPa, top_kPa, rate_kPa_per_s, 0.0, rest_s, sine=True)


def log_uniform(dice: random.Random, least: float, most: float) -> float:
    return math.exp(dice.uniform(math.log(least), math.log(most)))
