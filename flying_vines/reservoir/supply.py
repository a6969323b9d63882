"""The least supply with which an inflation is still done in the time that its profile gives it.

A valve that is wide open and chokes passes C p, p the absolute supply. What an inflation needs is therefore a
product of supply and time, D = ∫ p u dt, the same at every supply as long as the flow is choked; where it is
not, it takes 1/φ as long (ISO 6358). D goes with the air, D = κ · air: κ is believed from the valve's rating,
and learned from how far and how long the valve had to open. The floor is where a regulator that opens wide
only when it is well behind its setpoint just gets near the top before the setpoint falls.
"""

from __future__ import annotations

import math

from flying_vines.config import Pneumatics
from flying_vines.pneumatics.paper import ALPHA_KPA
from flying_vines.reservoir.bottle import AMBIENT_KPA, conductance_SL_per_s_kPa
from flying_vines.reservoir.flying import Inflation, tolerance_kPa

CRITICAL_RATIO = 0.3
"""b of a valve with fittings."""
RATING_SD = 0.25
"""Of ln κ before anything was seen: a valve's rating, and how much the bottle holds."""
WIDE_OPEN_SD = 0.05
PARTLY_OPEN_SD = 0.7
"""Of an opening near the dead zone, whose place is not known."""
SLUGGISH_S = 0.04
"""Of the time that the valve was told to be open, when it and the sensor were not there yet."""
RESPONSE_S = 0.1
"""What regulator and valve take to act …"""
WIDE_OPEN_ERROR_KPA = 2.0
"""… and how far behind its setpoint the control volume is when they do all that they can."""
MOST_KPA = 2000.0


class Demand:
    """Learns κ, in seconds · kPa absolute of supply per kPa of bottle."""

    def __init__(self, pneumatics: Pneumatics) -> None:
        conductance = conductance_SL_per_s_kPa(
            pneumatics.evp_flow_resistance_kPa_s_per_SL, pneumatics.full_kPa
        )
        self.ln = math.log(pneumatics.reservoir_volume_L / (ALPHA_KPA * conductance))
        self.variance = RATING_SD**2

    def learn(self, inflation: Inflation, air_kPa: float) -> None:
        """From an inflation that took so much of the bottle."""
        if inflation.valve_kPa_s <= 0.0 or air_kPa <= 0.0:
            return
        error = math.log(inflation.valve_kPa_s / air_kPa) - self.ln
        if not inflation.reached and error < 0.0:
            return
        sluggish = SLUGGISH_S * inflation.supply_kPa_abs / inflation.valve_kPa_s
        variance = (WIDE_OPEN_SD + PARTLY_OPEN_SD * inflation.partly + sluggish) ** 2
        gain = self.variance / (self.variance + variance)
        self.ln += gain * error
        # The dead zone is off by the same amount every time: no number of cycles averages that out.
        self.variance = max((1.0 - gain) * self.variance, min(self.variance, 0.3 * variance))


def least_supply_kPa(inflation: Inflation, air_kPa: float, demand_kPa_s: float) -> float:
    """Gauge, at the start of an inflation like this one, which takes `air_kPa` and needs `demand_kPa_s`.

    Never more than what it was done with.
    """
    low = AMBIENT_KPA + inflation.low_kPa
    high = max(low, inflation.supply_kPa_abs) if inflation.reached else MOST_KPA
    for _ in range(12):
        middle = 0.5 * (low + high)
        if _filled(inflation, demand_kPa_s, middle):
            high = middle
        else:
            low = middle
    # The supply falls meanwhile.
    return high - AMBIENT_KPA + 0.5 * air_kPa


def _filled(inflation: Inflation, demand_kPa_s: float, supply_kPa_abs: float) -> bool:
    """Whether the control volume gets near the top while the setpoint does not fall.

    The regulator opens as it falls behind, and adds no air on the way down.
    """
    swing, setpoints = inflation.swing_kPa, inflation.setpoints_kPa
    step_s = inflation.given_s / len(setpoints)
    late = math.ceil(RESPONSE_S / step_s)
    most_kPa = swing * supply_kPa_abs * step_s / max(1e-9, demand_kPa_s)
    cv = inflation.low_kPa
    for i, now in enumerate(setpoints):
        if i and now < setpoints[i - 1]:
            break
        setpoint = setpoints[i - late] if i >= late else inflation.low_kPa
        ratio = (AMBIENT_KPA + cv) / supply_kPa_abs
        if setpoint > cv and ratio < 1.0:
            share = 1.0
            if ratio > CRITICAL_RATIO:
                share = math.sqrt(1.0 - ((ratio - CRITICAL_RATIO) / (1.0 - CRITICAL_RATIO)) ** 2)
            cv = min(setpoint, cv + most_kPa * share * min(1.0, (setpoint - cv) / WIDE_OPEN_ERROR_KPA))
    return cv >= inflation.top_kPa - tolerance_kPa(swing)
