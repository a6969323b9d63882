"""The minimum supply pressure with which an inflation is completed in its profile's time.

A fully open, choked valve passes C p, with the absolute supply p; an unchoked one C p φ (ISO 6358). So an
inflation needs a product of pressure and time, D = ∫ p φ u dt, with the effective opening u. D is the same at
every supply. For a valve by Ohm's law, p φ is the pressure drop. D is proportional to the air, D = κ · air.
The prior of κ comes from the valve's rating. κ is learned from the openings of the valve over time. At the
minimum supply the control volume just gets near the top before the setpoint falls; the regulator opens the
valve in proportion to the error.
"""

from __future__ import annotations

import math

from flying_vines.physics.gas import ALPHA_KPA
from flying_vines.supply.air_use import ObservedInflation, driving_kPa, tolerance_kPa
from flying_vines.supply.rig_prior import AMBIENT_KPA, RigPrior

WIDE_OPEN_SD = 0.05
SLUGGISH_S = 0.04
"""Uncertainty of the open time: valve and sensor respond late."""
WIDE_OPEN_ERROR_KPA = 2.0
"""In this model the valve is fully open if the control volume is this far below its setpoint."""
MAX_KPA = 2000.0


class SupplyCost:
    """Learns κ, in seconds · kPa of absolute supply per kPa of the reservoir."""

    def __init__(self, prior: RigPrior) -> None:
        volume_L, law = prior.pneumatics.reservoir_volume_L, prior.evp_law.numbers()
        self.ln = math.log(volume_L / (ALPHA_KPA * law.conductance_SL_per_s_kPa))
        self.variance = prior.rating_sd**2
        self._partly_open_sd = prior.partly_open_sd

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


def min_supply_kPa(
    prior: RigPrior, inflation: ObservedInflation, air_kPa: float, demand_kPa_s: float
) -> float:
    """Minimum gauge supply at the start of an inflation that takes `air_kPa` and needs `demand_kPa_s` (D).

    If this inflation reached its top, the search does not go above its own supply pressure.
    """
    low = AMBIENT_KPA + inflation.low_kPa
    high = max(low, inflation.supply_kPa_abs) if inflation.reached else MAX_KPA
    for _ in range(12):
        middle = 0.5 * (low + high)
        if _filled(prior, inflation, demand_kPa_s, middle):
            high = middle
        else:
            low = middle
    # The supply falls during the inflation.
    return high - AMBIENT_KPA + 0.5 * air_kPa


def fillable(prior: RigPrior, inflation: ObservedInflation, demand_kPa_s: float) -> bool:
    """True if a supply of at most `MAX_KPA` completes this inflation in its time."""
    return _filled(prior, inflation, demand_kPa_s, MAX_KPA)


def _filled(
    prior: RigPrior, inflation: ObservedInflation, demand_kPa_s: float, supply_kPa_abs: float
) -> bool:
    """True if the control volume gets near the top before the setpoint falls.

    The regulator opens the valve in proportion to the error, and adds no air while the setpoint falls.
    """
    law = prior.evp_law.numbers()
    swing, setpoints = inflation.swing_kPa, inflation.setpoints_kPa
    step_s = inflation.given_s / len(setpoints)
    late = math.ceil(prior.response_s / step_s)
    max_per_kPa = swing * step_s / max(1e-9, demand_kPa_s)
    cv = inflation.low_kPa
    for i, now in enumerate(setpoints):
        if i and now < setpoints[i - 1]:
            break
        setpoint = setpoints[i - late] if i >= late else inflation.low_kPa
        if setpoint > cv:
            max_rise_kPa = max_per_kPa * driving_kPa(law, supply_kPa_abs, AMBIENT_KPA + cv)
            cv = min(setpoint, cv + max_rise_kPa * min(1.0, (setpoint - cv) / WIDE_OPEN_ERROR_KPA))
    return cv >= inflation.top_kPa - tolerance_kPa(swing)
