"""The firmware's settings for valves that take its word only once a sample.

At the firmware's own rate the regulator is as compiled. A valve that stays as it is for 20 ms moves the
vine's 0.1 L by 7 kPa meanwhile; with gains for 1 ms it would only swing about the setpoint.
"""

from __future__ import annotations

from dataclasses import replace

from flying_vines.physics.constants import ALPHA_KPA
from flying_vines.physics.rig import ControlVolume, Rig
from flying_vines.simulation.phlosar.firmware import FirmwareSettings
from flying_vines.simulation.phlosar.regulator import RegulatorSettings
from flying_vines.simulation.scenario.kinds import FIRMWARE_HZ, MOST_KPA

_LIMIT_KPA = 200.0
_FASTEST_KPA_PER_S = 1e6
"""So that a step is a step."""
_OF_THE_ERROR = 0.4
"""How much of an error one hold may make good."""
_HOLDS_OF_FULL_OPENING = 1.5
"""How far from the setpoint the valves still go fully open."""
_TOLERATED_HOLDS = 0.09
"""How far above the setpoint the solenoid stays shut: one hold of it lets out much more than noise."""


def firmware_for(rig: Rig, cv: ControlVolume, reservoir_kPa: float, sample_rate_Hz: int) -> FirmwareSettings:
    """Limits wide enough for every scenario, gains for the sample rate."""
    settings = FirmwareSettings(
        build="simulated",
        cv_limit_kPa=_LIMIT_KPA,
        setpoint_margin_kPa=_LIMIT_KPA - MOST_KPA - 1.0,
        reservoir_limit_kPa=1000.0,
        rate_limit_kPa_per_s=_FASTEST_KPA_PER_S,
        sensor_beyond_span=0.5,  # to a vacuum
    )
    if sample_rate_Hz >= FIRMWARE_HZ:
        return settings
    hold_s = 1.0 / sample_rate_Hz
    rate_kPa_per_s = ALPHA_KPA * reservoir_kPa / (rig.evp.flow_resistance_kPa_s_per_SL * cv.volume_L)
    return replace(settings, regulator=_patient(settings.regulator, hold_s, rate_kPa_per_s * hold_s))


def _patient(regulator: RegulatorSettings, hold_s: float, hold_kPa: float) -> RegulatorSettings:
    """For valves that stay as they are for `hold_s`, which moves the pressure by up to `hold_kPa`."""
    share = min(1.0, _OF_THE_ERROR / (regulator.proportional_per_kPa * hold_kPa))
    return regulator._replace(
        filling_lead_s=regulator.filling_lead_s + hold_s,
        venting_lead_s=regulator.venting_lead_s + hold_s,
        passive_first_s=regulator.passive_first_s + 2.0 * hold_s,
        on_off_error_kPa=max(regulator.on_off_error_kPa, _HOLDS_OF_FULL_OPENING * hold_kPa),
        tolerated_kPa=max(regulator.tolerated_kPa, _TOLERATED_HOLDS * hold_kPa),
        proportional_per_kPa=share * regulator.proportional_per_kPa,
        integral_per_kPa_s=min(1.0, 1.0 / hold_kPa) * regulator.integral_per_kPa_s,
        integral_forgets=max(1.0, hold_kPa / 2.0) * regulator.integral_forgets,
    )
