"""Tunes the regulator for valves that move only once per sample.

At the firmware's own rate the tuning is the standard one. A valve that is constant for 20 ms changes the
pressure of a 0.1 L vine by up to 7 kPa; with the gains for 1 ms the pressure would oscillate.
"""

from __future__ import annotations

from flying_vines.physics.constants import ALPHA_KPA
from flying_vines.physics.rig import ControlVolume, Rig
from flying_vines.simulation.phlosar.regulator import Tuning, standard_tuning
from flying_vines.simulation.scenario.run_kinds import FIRMWARE_HZ

FASTEST_KPA_PER_S = 1e6
"""Practically no rate limit, so that a step stays a step."""
_OF_THE_ERROR = 0.4
"""Share of the error that one sample may correct."""
_HOLDS_OF_FULL_OPENING = 1.5
"""Error from which the valves open fully, as a multiple of the maximum pressure change in one sample."""
_TOLERATED_HOLDS = 0.09
"""Excess over the setpoint up to which the solenoid stays shut, as a multiple of the maximum pressure change
in one sample."""


def tuning_for(rig: Rig, cv: ControlVolume, reservoir_kPa: float, sample_rate_Hz: int) -> Tuning:
    """Tuning for valves that are constant during a sample."""
    if sample_rate_Hz >= FIRMWARE_HZ:
        return {}
    hold_s = 1.0 / sample_rate_Hz
    rate_kPa_per_s = ALPHA_KPA * reservoir_kPa / (rig.evp.flow_resistance_kPa_s_per_SL * cv.volume_L)
    # The maximum pressure change in one sample.
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
