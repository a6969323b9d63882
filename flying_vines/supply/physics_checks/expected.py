"""The bounds of a healthy rig: the prior's numbers, and the allowed deviations from them.

These are bounds, not best guesses. A check that uses the lenient bound finds nothing on any rig within the
bounds.
"""

from __future__ import annotations

from dataclasses import dataclass

from flying_vines.config.config import ChecksConfig
from flying_vines.physics.gas import ALPHA_KPA
from flying_vines.physics.plant.flow import Opening
from flying_vines.physics.plant.volume import Wall
from flying_vines.supply import Features, RigPrior
from flying_vines.supply.air_use import driving_kPa
from flying_vines.supply.rig_prior import AMBIENT_KPA, MIN_RISE_SHARE, conductance_SL_per_s_kPa

MIN_FLOW, MAX_FLOW = 0.7, 1.4
"""The valve's flow as a share of its rating."""
MIN_DEAD, MAX_DEAD = 0.15, 0.5
"""Opening up to which a proportional valve stays shut, including its play."""
SUPPLY_ERROR_KPA = 25.0
"""Whole error band of the reservoir's sensor."""
SOFTNESS = 4.0
"""For a rise, a soft vine takes up to this many times the air of a rigid one of its size."""
MAX_OUTLET_KPA_S_PER_SL = 120.0
"""Flow resistance from the vine to ambient through solenoid and Venturi. A small solenoid has 70."""
OUTLET_LAG_S = 0.15
"""Maximum total lag of the outlet: solenoid, tube and sensor."""


@dataclass(frozen=True)
class Expected:
    """The bounds of one rig."""

    vine_min_L: float
    vine_max_L: float
    reservoir_L: float
    wall: Wall
    """The reservoir's wall."""
    full_kPa: float
    evp_law: Opening
    """As rated."""
    dvp_SL_per_s_kPa: float
    zero_kPa: float
    """Maximum reading of a good sensor on a vented vine."""

    def min_inflow_SL(self, now: Features) -> float:
        """The air that certainly went into the vine since the last message."""
        effective = max(0.0, (now.min_evp - MAX_DEAD) / (1.0 - MAX_DEAD))
        if effective == 0.0:
            return 0.0
        return effective * self.open_inflow_SL(now)

    def open_inflow_SL(self, now: Features) -> float:
        """The air that a fully open valve would certainly have let in since the last message."""
        supply_kPa = AMBIENT_KPA + now.telemetry.reservoir_kPa - SUPPLY_ERROR_KPA
        through = driving_kPa(self.evp_law, supply_kPa, AMBIENT_KPA + max(0.0, now.cv_median_kPa))
        return now.device_dt_s * (MIN_FLOW * self.evp_law.conductance_SL_per_s_kPa * through)

    def max_outflow_SL(self, now: Features) -> float:
        """The air that the valves may have taken out of the reservoir since the last message."""
        supply_kPa = AMBIENT_KPA + now.telemetry.reservoir_kPa + SUPPLY_ERROR_KPA
        inflation = self.evp_law.conductance_SL_per_s_kPa * _max_effective(now.max_evp)
        venturi = self.dvp_SL_per_s_kPa * _max_effective(now.max_dvp)
        return now.device_dt_s * (MAX_FLOW * supply_kPa * (inflation + venturi))

    def open_evp_SL_per_s(self, reservoir_kPa: float) -> float:
        """Rated flow through the fully open inflation valve."""
        return self.evp_law.conductance_SL_per_s_kPa * (AMBIENT_KPA + reservoir_kPa)

    def reservoir_fall_kPa(self, air_SL: float) -> float:
        """The fall of the reservoir's pressure after this air has left and the gas is warm again."""
        return air_SL * ALPHA_KPA / self.reservoir_L

    def max_air_SL(self, rise_kPa: float) -> float:
        """Maximum air of a vine for a rise, once it is not flat."""
        return SOFTNESS * self.vine_max_L * rise_kPa / ALPHA_KPA

    def min_air_SL(self, rise_kPa: float) -> float:
        """Minimum air of a vine for a rise."""
        return MIN_RISE_SHARE * self.vine_min_L * rise_kPa / ALPHA_KPA

    @property
    def slowest_vent_s(self) -> float:
        """Maximum time constant of a venting vine (fall to 1/e)."""
        return SOFTNESS * self.vine_max_L * MAX_OUTLET_KPA_S_PER_SL / ALPHA_KPA


def _max_effective(opening: float) -> float:
    return max(0.0, (opening - MIN_DEAD) / (1.0 - MIN_DEAD))


def expected(prior: RigPrior, checks: ChecksConfig) -> Expected:
    """The bounds around a rig's prior."""
    p = prior.pneumatics
    return Expected(
        vine_min_L=p.cv_volume_L / checks.volume_factor,
        vine_max_L=p.cv_volume_L * checks.volume_factor,
        reservoir_L=p.reservoir_volume_L,
        wall=prior.wall,
        full_kPa=p.full_kPa,
        evp_law=prior.evp_law.numbers(),
        dvp_SL_per_s_kPa=conductance_SL_per_s_kPa(p.dvp_flow_resistance_kPa_s_per_SL, p.full_kPa),
        zero_kPa=checks.zero_kPa,
    )
