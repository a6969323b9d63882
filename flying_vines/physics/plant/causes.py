"""The named causes as settings: a rig and a cause's parameters make a plant and its two sensors.

Names and definitions are those of the table of causes in the rig-data format.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from flying_vines.physics.plant.ambient import Climb
from flying_vines.physics.plant.effects import Effects
from flying_vines.physics.plant.flow import Iso6358, Ohm, iso6358_matching
from flying_vines.physics.plant.motion import SolenoidTiming, ValveMotion
from flying_vines.physics.plant.plant import Plant
from flying_vines.physics.plant.sensors import Sensor
from flying_vines.physics.plant.shape import Compliant
from flying_vines.physics.plant.venturi import Ejector
from flying_vines.physics.plant.wall import Wall
from flying_vines.physics.rig import ControlVolume, Rig


@dataclass(frozen=True)
class Setup:
    """A plant and what reads it."""

    plant: Plant
    cv_sensor: Sensor
    reservoir_sensor: Sensor


def setup(rig: Rig, cause: str = "none", **parameters: float) -> Setup:
    """The rig with one cause; its sensors have the rig's noise. KeyError for a name that is not in the
    table."""
    base = Setup(
        Plant(rig),
        Sensor(206.84, noise_std_kPa=rig.sensors.cv_noise_std_kPa),
        Sensor(1500.0, noise_std_kPa=rig.sensors.reservoir_noise_std_kPa),
    )
    return CAUSES[cause](base, **parameters)


def _effects(base: Setup, effects: Effects) -> Setup:
    return replace(base, plant=replace(base.plant, effects=effects))


def _rig(base: Setup, rig: Rig) -> Setup:
    return replace(base, plant=replace(base.plant, rig=rig))


def _reservoir_leak(base: Setup, flow_resistance_kPa_s_per_SL: float) -> Setup:
    return _effects(base, Effects(reservoir_leak=Ohm(flow_resistance_kPa_s_per_SL)))


def _cv_leak(base: Setup, flow_resistance_kPa_s_per_SL: float) -> Setup:
    return _effects(base, Effects(cv_leak=Ohm(flow_resistance_kPa_s_per_SL)))


def _compressible_flow(base: Setup, critical_pressure_ratio: float) -> Setup:
    def law(flow_resistance_kPa_s_per_SL: float) -> Iso6358:
        return iso6358_matching(
            flow_resistance_kPa_s_per_SL,
            critical_pressure_ratio=critical_pressure_ratio,
            laminar_ratio=1.0,
            temperature_dependent=False,
            one_way=True,
        )

    rig = base.plant.rig
    return _effects(
        base,
        Effects(
            evp_law=law(rig.evp.flow_resistance_kPa_s_per_SL),
            dvp_law=law(rig.dvp.flow_resistance_kPa_s_per_SL),
        ),
    )


def _reservoir_cooling(base: Setup, time_constant_s: float) -> Setup:
    return _effects(base, Effects(reservoir_wall=Wall(time_constant_s)))


def _cv_heating(base: Setup, time_constant_s: float) -> Setup:
    return _effects(base, Effects(cv_wall=Wall(time_constant_s)))


def _cv_compliance(base: Setup, per_kPa: float) -> Setup:
    return _effects(base, Effects(cv_shape=Compliant(per_kPa)))


def _dead_volume(base: Setup, volume_L: float) -> Setup:
    cv = base.plant.rig.cv
    if cv is None:
        raise ValueError("a rig without a control volume has no dead volume")
    return _rig(base, replace(base.plant.rig, cv=ControlVolume(cv.volume_L + volume_L)))


def _reservoir_volume(base: Setup, scale: float) -> Setup:
    rig = base.plant.rig
    return _rig(base, replace(rig, reservoir=replace(rig.reservoir, volume_L=scale * rig.reservoir.volume_L)))


def _evp_restriction(base: Setup, scale: float) -> Setup:
    rig = base.plant.rig
    resistance = scale * rig.evp.flow_resistance_kPa_s_per_SL
    return _rig(base, replace(rig, evp=replace(rig.evp, flow_resistance_kPa_s_per_SL=resistance)))


def _evp_dead_zone(base: Setup, opening: float) -> Setup:
    return _effects(base, Effects(evp_motion=ValveMotion(dead_opening=opening)))


def _evp_hysteresis(base: Setup, width: float) -> Setup:
    return _effects(base, Effects(evp_motion=ValveMotion(backlash_width=width)))


def _evp_lag(base: Setup, time_constant_s: float) -> Setup:
    return _effects(base, Effects(evp_motion=ValveMotion(time_constant_s=time_constant_s)))


def _line_delay(base: Setup, delay_s: float) -> Setup:
    return _effects(base, Effects(evp_motion=ValveMotion(delay_s=delay_s)))


def _solenoid_slow_close(base: Setup, delay_s: float) -> Setup:
    return _effects(base, Effects(solenoid_timing=SolenoidTiming(closing_s=delay_s)))


def _venturi_stall(base: Setup, supply_pressure_kPa: float) -> Setup:
    return _effects(base, Effects(ejector=Ejector(stall_supply_kPa=supply_pressure_kPa)))


def _cv_sensor_lag(base: Setup, time_constant_s: float) -> Setup:
    return replace(base, cv_sensor=replace(base.cv_sensor, time_constant_s=time_constant_s))


def _cv_sensor_offset(base: Setup, offset_kPa: float) -> Setup:
    return replace(base, cv_sensor=replace(base.cv_sensor, offset_kPa=offset_kPa))


def _cv_sensor_gain(base: Setup, gain: float) -> Setup:
    return replace(base, cv_sensor=replace(base.cv_sensor, gain=gain))


def _reservoir_sensor_offset(base: Setup, offset_kPa: float) -> Setup:
    return replace(base, reservoir_sensor=replace(base.reservoir_sensor, offset_kPa=offset_kPa))


def _reservoir_sensor_gain(base: Setup, gain: float) -> Setup:
    return replace(base, reservoir_sensor=replace(base.reservoir_sensor, gain=gain))


def _ambient_drop(base: Setup, rate_kPa_per_s: float) -> Setup:
    return _effects(base, Effects(ambient=Climb(rate_kPa_per_s)))


def _none(base: Setup) -> Setup:
    return base


CAUSES: dict[str, Callable[..., Setup]] = {
    "none": _none,
    "reservoir_leak": _reservoir_leak,
    "cv_leak": _cv_leak,
    "compressible_flow": _compressible_flow,
    "reservoir_cooling": _reservoir_cooling,
    "cv_heating": _cv_heating,
    "cv_compliance": _cv_compliance,
    "dead_volume": _dead_volume,
    "reservoir_volume": _reservoir_volume,
    "evp_restriction": _evp_restriction,
    "evp_dead_zone": _evp_dead_zone,
    "evp_hysteresis": _evp_hysteresis,
    "evp_lag": _evp_lag,
    "line_delay": _line_delay,
    "solenoid_slow_close": _solenoid_slow_close,
    "venturi_stall": _venturi_stall,
    "cv_sensor_lag": _cv_sensor_lag,
    "cv_sensor_offset": _cv_sensor_offset,
    "cv_sensor_gain": _cv_sensor_gain,
    "reservoir_sensor_offset": _reservoir_sensor_offset,
    "reservoir_sensor_gain": _reservoir_sensor_gain,
    "ambient_drop": _ambient_drop,
}
"""Each takes the perfect setup and its parameters by the table's names."""
