"""How a valve and its coil follow a command, and the delays of a solenoid.

Delay, backlash, dead zone, heating and lag act in this order. In `tick` the first four change once per tick
of the firmware, and delays are whole ticks. (Fits use the exact times of `commands.followed`.) The lag is
exact for any step: dx/dt = (target − x) / τ.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, expm1

from flying_vines.physics.gas import STANDARD_TEMPERATURE_K


@dataclass(frozen=True)
class ValveMotion:
    """Motion of a proportional valve. With the defaults the opening is the command.

    `backlash_width` is the full width of the backlash as a share of full command; a command of 0 shuts the
    valve and resets the backlash. `dead_opening` is the command up to which the valve stays shut. A driven
    coil warms up: dw/dt = (u − w) / `heating_time_s`. The valve then loses the share w · `heating_share` of
    its opening.
    """

    delay_s: float = 0.0
    backlash_width: float = 0.0
    dead_opening: float = 0.0
    time_constant_s: float = 0.0
    heating_share: float = 0.0
    heating_time_s: float = 1.0

    def __post_init__(self) -> None:
        if not (0.0 <= self.heating_share < 1.0 and self.heating_time_s > 0.0):
            raise ValueError("the share lost by heating must be in 0…1, and its time constant positive")
        if not (self.delay_s >= 0.0 and self.backlash_width >= 0.0 and self.time_constant_s >= 0.0):
            raise ValueError("delay, backlash and lag must not be negative")
        if not 0.0 <= self.dead_opening < 1.0:
            raise ValueError("a dead zone must be in 0…1")


CLIPPARD_EVP = ValveMotion(delay_s=0.003, backlash_width=0.1, dead_opening=0.3, time_constant_s=0.010)
"""Hysteresis from the manufacturer (10 % nominal); dead zone, lag and delay are assumptions."""
CLIPPARD_DVP = ValveMotion(delay_s=0.004, backlash_width=0.1, dead_opening=0.3, time_constant_s=0.020)
"""As the EVP, but slower. Assumption."""


@dataclass(frozen=True)
class SolenoidTiming:
    """Delays of a solenoid: it switches after the command has lasted for this time."""

    opening_s: float = 0.0
    closing_s: float = 0.0

    def __post_init__(self) -> None:
        if not (self.opening_s >= 0.0 and self.closing_s >= 0.0):
            raise ValueError("a solenoid's delays must not be negative")


HUAMEI_12V = SolenoidTiming(opening_s=0.010, closing_s=0.020)
"""Usual values of small solenoids. Assumption."""


def backlash(held: float, command: float, width: float) -> float:
    """The play operator: of all values within width/2 of the command, the one nearest to `held`."""
    if command <= 0.0:
        return 0.0
    half = width / 2.0
    return max(command - half, min(command + half, held))


def dead_zone(command: float, dead_opening: float) -> float:
    """max(0, (u − u₀) / (1 − u₀)), at most 1: a full command still opens fully."""
    return min(1.0, max(0.0, (command - dead_opening) / (1.0 - dead_opening)))


def warmth_after(motion: ValveMotion, warmth: float, command: float, dt_s: float) -> float:
    """The coil's warmth `dt_s` later, with a constant command; at full command it approaches 1."""
    return command + (warmth - command) * exp(-dt_s / motion.heating_time_s)


def ticks(delay_s: float, tick_s: float) -> int:
    """A delay, rounded to whole ticks."""
    return round(delay_s / tick_s)


def solenoid_after(
    is_open: bool, waited_ticks: int, told_open: bool, opening_ticks: int, closing_ticks: int
) -> tuple[bool, int]:
    """True if the solenoid is open during this tick; and for how many ticks the command has differed."""
    if told_open == is_open:
        return is_open, 0
    if waited_ticks >= (opening_ticks if told_open else closing_ticks):
        return told_open, 0
    return is_open, waited_ticks + 1


def opening_after(per_s: float, opening: float, target: float, dt_s: float) -> float:
    """The opening of a valve `dt_s` later; `per_s` is 1/τ, 0 without a lag."""
    if per_s == 0.0:
        return target
    return target + (opening - target) * exp(-dt_s * per_s)


def opening_midway(per_s: float, opening: float, target: float, dt_s: float) -> float:
    """The opening at half a step for which Simpson's rule gives the exact mean over the step."""
    steps = dt_s * per_s
    if steps < 1e-6:
        return opening_after(per_s, opening, target, 0.5 * dt_s)
    mean = -expm1(-steps) / steps
    return target + (opening - target) * (6.0 * mean - 1.0 - exp(-steps)) / 4.0


COPPER_PER_K = 0.0039
"""Temperature coefficient of copper's resistance."""


@dataclass(frozen=True)
class Coil:
    """A valve's coil on one channel of an L298N: its current at a duty cycle u, and how its copper warms.

        i = u (V_s − V_d) / (R (1 + a (T − 293.15 K)) + R_d)        share of full command = i / i_full
        C dT/dt = i² R(T) − (T − T_a) / R_th

    The opening of a valve is affine in current (the paper), but the driver switches voltage. With the
    defaults a cold 5 V coil just opens fully.

    The drop, 1.0 V plus 0.8 Ω, is near 1.2 V at 0.3 A and 1.8 V at 1 A (data sheet, from memory).
    Assumptions: the coil's resistance (1.9 W at 5 V), its thermal numbers, and a smooth current under PWM.
    """

    supply_V: float = 6.3
    drop_V: float = 1.0
    drop_ohm: float = 0.8
    resistance_ohm: float = 13.5
    full_current_A: float = 0.37
    thermal_resistance_K_per_W: float = 25.0
    heat_capacity_J_per_K: float = 20.0

    def __post_init__(self) -> None:
        if not (self.supply_V > self.drop_V >= 0.0 and self.drop_ohm >= 0.0):
            raise ValueError("a driver's supply must be above its drop, and drops must not be negative")
        if not (self.resistance_ohm > 0.0 and self.full_current_A > 0.0):
            raise ValueError("a coil's resistance and full current must be positive")
        if not (self.thermal_resistance_K_per_W >= 0.0 and self.heat_capacity_J_per_K > 0.0):
            raise ValueError("a coil's heat capacity must be positive, its thermal resistance not negative")


def resistance_ohm(coil: Coil, temperature_K: float) -> float:
    """R (1 + a (T − 293.15 K))."""
    return coil.resistance_ohm * (1.0 + COPPER_PER_K * (temperature_K - STANDARD_TEMPERATURE_K))


def current_A(coil: Coil, duty: float, temperature_K: float) -> float:
    """The mean current at a duty cycle 0…1."""
    return duty * (coil.supply_V - coil.drop_V) / (resistance_ohm(coil, temperature_K) + coil.drop_ohm)


def temperature_after_K(
    coil: Coil, temperature_K: float, current: float, ambient_K: float, dt_s: float
) -> float:
    """The coil's temperature `dt_s` later; exact if current and resistance are constant."""
    warmer_K = current * current * resistance_ohm(coil, temperature_K) * coil.thermal_resistance_K_per_W
    if coil.thermal_resistance_K_per_W == 0.0:
        return ambient_K
    final_K = ambient_K + warmer_K
    left = exp(-dt_s / (coil.thermal_resistance_K_per_W * coil.heat_capacity_J_per_K))
    return final_K + (temperature_K - final_K) * left
