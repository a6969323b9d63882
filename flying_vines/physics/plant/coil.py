"""Current of a valve's coil at a duty cycle, with the driver's voltage drop and the warming of the copper.

    i = u (V_s − V_d) / (R (1 + a (T − 293.15 K)) + R_d)        share of full command = i / i_full
    C dT/dt = i² R(T) − (T − T_a) / R_th

The opening of a valve is affine in current (the paper), but the driver switches voltage.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp

from flying_vines.physics.constants import STANDARD_TEMPERATURE_K

COPPER_PER_K = 0.0039
"""Temperature coefficient of copper's resistance."""


@dataclass(frozen=True)
class Coil:
    """A valve's coil on one channel of an L298N. With the defaults a cold 5 V coil just opens fully.

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
