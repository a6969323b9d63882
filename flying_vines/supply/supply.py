"""The lowest supply pressure with which an inflation is still done in its profile's time.

A valve that is wide open and chokes passes C p, p the absolute supply; one that does not, C p φ (ISO 6358).
What an inflation needs is therefore a product of pressure and time, D = ∫ p φ u dt, the same at every supply;
p φ is the drop where a valve follows Ohm's law. D goes with the air, D = κ · air: κ is believed from the
valve's rating, and learned from how far and how long the valve had to open. The floor is where a regulator
that opens wide only when it is well behind its setpoint just gets near the top before the setpoint falls.
"""

from __future__ import annotations

import math

from flying_vines.physics.constants import ALPHA_KPA
from flying_vines.supply.belief import AMBIENT_KPA, Belief
from flying_vines.supply.flying import ObservedInflation, driving_kPa, tolerance_kPa

WIDE_OPEN_SD = 0.05
SLUGGISH_S = 0.04
"""Of the time of the open command, during which valve and sensor had not responded yet."""
WIDE_OPEN_ERROR_KPA = 2.0
"""How far the control volume is below its setpoint when the valve is fully open."""
MOST_KPA = 2000.0


class SupplyCost:
    """Learns κ, in seconds · kPa absolute of supply per kPa of bottle."""

    def __init__(self, belief: Belief) -> None:
        volume_L, law = belief.pneumatics.reservoir_volume_L, belief.evp_law.numbers()
        self.ln = math.log(volume_L / (ALPHA_KPA * law.conductance_SL_per_s_kPa))
        self.variance = belief.rating_sd**2
        self._partly_open_sd = belief.partly_open_sd

    def learn(self, inflation: ObservedInflation, air_kPa: float) -> None:
        """Learn from an inflation that took `air_kPa` of the reservoir."""
        if inflation.valve_kPa_s <= 0.0 or air_kPa <= 0.0:
            return
        error = math.log(inflation.valve_kPa_s / air_kPa) - self.ln
        if not inflation.reached and error < 0.0:
            return
        sluggish = SLUGGISH_S * inflation.supply_kPa_abs / inflation.valve_kPa_s
        variance = (WIDE_OPEN_SD + self._partly_open_sd * inflation.partly + sluggish) ** 2
        gain = self.variance / (self.variance + variance)
        self.ln += gain * error
        # The dead zone's error is the same every time: it does not average out.
        self.variance = max((1.0 - gain) * self.variance, min(self.variance, 0.3 * variance))


def least_supply_kPa(
    belief: Belief, inflation: ObservedInflation, air_kPa: float, demand_kPa_s: float
) -> float:
    """Gauge, at the start of an inflation like this one, which takes `air_kPa` and needs `demand_kPa_s`.

    At most the pressure with which this one was done.
    """
    low = AMBIENT_KPA + inflation.low_kPa
    high = max(low, inflation.supply_kPa_abs) if inflation.reached else MOST_KPA
    for _ in range(12):
        middle = 0.5 * (low + high)
        if _filled(belief, inflation, demand_kPa_s, middle):
            high = middle
        else:
            low = middle
    # The supply falls meanwhile.
    return high - AMBIENT_KPA + 0.5 * air_kPa


def _filled(belief: Belief, inflation: ObservedInflation, demand_kPa_s: float, supply_kPa_abs: float) -> bool:
    """Whether the control volume gets near the top before the setpoint falls.

    The regulator opens in proportion to the error, and adds no air on the way down.
    """
    law = belief.evp_law.numbers()
    swing, setpoints = inflation.swing_kPa, inflation.setpoints_kPa
    step_s = inflation.given_s / len(setpoints)
    late = math.ceil(belief.response_s / step_s)
    most_per_kPa = swing * step_s / max(1e-9, demand_kPa_s)
    cv = inflation.low_kPa
    for i, now in enumerate(setpoints):
        if i and now < setpoints[i - 1]:
            break
        setpoint = setpoints[i - late] if i >= late else inflation.low_kPa
        if setpoint > cv:
            most_kPa = most_per_kPa * driving_kPa(law, supply_kPa_abs, AMBIENT_KPA + cv)
            cv = min(setpoint, cv + most_kPa * min(1.0, (setpoint - cv) / WIDE_OPEN_ERROR_KPA))
    return cv >= inflation.top_kPa - tolerance_kPa(swing)
