"""How the regulator is tuned for valves that move only once a sample.

At the firmware's own rate it has its standard tuning. A valve that stays as it is for 20 ms moves the vine's
0.1 L by 7 kPa meanwhile; with gains for 1 ms it would only swing about the setpoint.
"""

from __future__ import annotations

from flying_vines.physics.constants import ALPHA_KPA
from flying_vines.physics.rig import ControlVolume, Rig
from flying_vines.simulation.phlosar.regulator import Tuning, standard_tuning
from flying_vines.simulation.scenario.kinds import FIRMWARE_HZ

FASTEST_KPA_PER_S = 1e6
"""So that a step is a step."""
_OF_THE_ERROR = 0.4
"""How much of an error one hold may make good."""
_HOLDS_OF_FULL_OPENING = 1.5
"""How far from the setpoint the valves still go fully open."""
_TOLERATED_HOLDS = 0.09
"""How far above the setpoint the solenoid stays shut: one hold of it lets out much more than noise."""


def tuning_for(rig: Rig, cv: ControlVolume, reservoir_kPa: float, sample_rate_Hz: int) -> Tuning:
    """For a valve that stays as it is for a sample, and moves the pressure by up to `hold_kPa` meanwhile."""
    if sample_rate_Hz >= FIRMWARE_HZ:
        return {}
    hold_s = 1.0 / sample_rate_Hz
    rate_kPa_per_s = ALPHA_KPA * reservoir_kPa / (rig.evp.flow_resistance_kPa_s_per_SL * cv.volume_L)
    hold_kPa = rate_kPa_per_s * hold_s
    standard = standard_tuning()
    share = min(1.0, _OF_THE_ERROR / (standard["proportional_per_kPa"] * hold_kPa))
    return {
        "filling_lead_s": standard["filling_lead_s"] + hold_s,
        "venting_lead_s": standard["venting_lead_s"] + hold_s,
        "passive_first_s": standard["passive_first_s"] + 2.0 * hold_s,
        "on_off_error_kPa": max(standard["on_off_error_kPa"], _HOLDS_OF_FULL_OPENING * hold_kPa),
        "tolerated_kPa": max(standard["tolerated_kPa"], _TOLERATED_HOLDS * hold_kPa),
        "proportional_per_kPa": share * standard["proportional_per_kPa"],
        "integral_per_kPa_s": min(1.0, 1.0 / hold_kPa) * standard["integral_per_kPa_s"],
        "integral_forgets": max(1.0, hold_kPa / 2.0) * standard["integral_forgets"],
    }
