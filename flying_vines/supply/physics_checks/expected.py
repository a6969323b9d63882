"""What a rig does at least and at most: the believed numbers, and how far a healthy rig may be from them.

These are bounds, not best guesses. A check that uses the lenient bound stays silent on every rig within the
bounds. The reason for its width stands beside each bound.
"""

from __future__ import annotations

from dataclasses import dataclass

from flying_vines.config.config import ChecksConfig
from flying_vines.physics.constants import ALPHA_KPA
from flying_vines.physics.plant.flow import Opening
from flying_vines.supply import Belief, Features
from flying_vines.supply.belief import AMBIENT_KPA, conductance_SL_per_s_kPa
from flying_vines.supply.flying import driving_kPa

LEAST_FLOW, MOST_FLOW = 0.7, 1.4
"""Of what the valve's rating says."""
LEAST_DEAD, MOST_DEAD = 0.15, 0.5
"""Opening up to which a proportional valve stays shut, its play included."""
SUPPLY_ERROR_KPA = 25.0
"""Of the bottle's sensor: its whole error band."""
SOFTNESS = 4.0
"""How much more air a soft vine takes for a rise than a rigid one of its size."""
LEAST_RISE = 0.65
"""How much less a warm vine takes: gas that was compressed quickly has not cooled yet."""
SLOWEST_OUTLET_KPA_S_PER_SL = 120.0
"""From the vine to the outside through solenoid and Venturi; a small solenoid has 70."""


@dataclass(frozen=True)
class Expected:
    """Of one rig."""

    vine_least_L: float
    vine_most_L: float
    bottle_L: float
    full_kPa: float
    evp_law: Opening
    """As rated."""
    dvp_SL_per_s_kPa: float
    zero_kPa: float
    """What a sound sensor may read on a vented vine."""

    def least_inflow_SL(self, now: Features) -> float:
        """What has gone into the vine for sure since the message before."""
        effective = max(0.0, (now.least_evp - MOST_DEAD) / (1.0 - MOST_DEAD))
        if effective == 0.0:
            return 0.0
        supply_kPa = AMBIENT_KPA + now.telemetry.reservoir_kPa - SUPPLY_ERROR_KPA
        through = driving_kPa(self.evp_law, supply_kPa, AMBIENT_KPA + max(0.0, now.cv_median_kPa))
        return now.device_dt_s * (LEAST_FLOW * effective * self.evp_law.conductance_SL_per_s_kPa * through)

    def most_outflow_SL(self, now: Features) -> float:
        """What the valves may have taken out of the bottle since the message before."""
        supply_kPa = AMBIENT_KPA + now.telemetry.reservoir_kPa + SUPPLY_ERROR_KPA
        inflation = self.evp_law.conductance_SL_per_s_kPa * _most_effective(now.most_evp)
        venturi = self.dvp_SL_per_s_kPa * _most_effective(now.most_dvp)
        return now.device_dt_s * (MOST_FLOW * supply_kPa * (inflation + venturi))

    def open_evp_SL_per_s(self, bottle_kPa: float) -> float:
        """Through the inflation valve, wide open, as rated."""
        return self.evp_law.conductance_SL_per_s_kPa * (AMBIENT_KPA + bottle_kPa)

    def bottle_fall_kPa(self, air_SL: float) -> float:
        """For air that has left it, once it is warm again."""
        return air_SL * ALPHA_KPA / self.bottle_L

    def most_air_SL(self, rise_kPa: float) -> float:
        """The most that a full vine takes for a rise."""
        return SOFTNESS * self.vine_most_L * rise_kPa / ALPHA_KPA

    def least_air_SL(self, rise_kPa: float) -> float:
        """The least that a vine takes for a rise."""
        return LEAST_RISE * self.vine_least_L * rise_kPa / ALPHA_KPA

    @property
    def slowest_vent_s(self) -> float:
        """The longest time in which a vine falls to 1/e."""
        return SOFTNESS * self.vine_most_L * SLOWEST_OUTLET_KPA_S_PER_SL / ALPHA_KPA


def _most_effective(opening: float) -> float:
    return max(0.0, (opening - LEAST_DEAD) / (1.0 - LEAST_DEAD))


def expected(belief: Belief, checks: ChecksConfig) -> Expected:
    """The bounds for a believed rig."""
    p = belief.pneumatics
    return Expected(
        vine_least_L=p.cv_volume_L / checks.volume_factor,
        vine_most_L=p.cv_volume_L * checks.volume_factor,
        bottle_L=p.reservoir_volume_L,
        full_kPa=p.full_kPa,
        evp_law=belief.evp_law.numbers(),
        dvp_SL_per_s_kPa=conductance_SL_per_s_kPa(p.dvp_flow_resistance_kPa_s_per_SL, p.full_kPa),
        zero_kPa=checks.zero_kPa,
    )
