"""Typical strength of each cause, and the strengths at which its trace is computed.

A plan must separate causes at the strengths of real rigs: typical leaks, valves, walls and sensors, from the
same sources as the ranges of the parameters. A cause that imitates another may have any strength. So its
trace is computed from almost no effect to many times the typical strength, and interpolated linearly.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isinf

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.rig import Rig

TYPICAL = {
    "ambient_drop": 0.07,
    "compressible_flow": 0.3,
    "cv_compliance": 0.005,
    "cv_heating": 2.0,
    "cv_leak": 550.0,
    "cv_sensor_drift": 1.5,
    "cv_sensor_gain": 1.04,
    "cv_sensor_lag": 0.03,
    "cv_sensor_offset": 1.5,
    "evp_dead_zone": 0.2,
    "evp_heating": 0.15,
    "evp_hysteresis": 0.1,
    "evp_lag": 0.017,
    "evp_restriction": 1.18,
    "hose": 30.0,
    "line_delay": 0.03,
    "orifice_leak": 3e-4,
    "reservoir_cooling": 9.0,
    "reservoir_leak": 8000.0,
    "reservoir_orifice_leak": 1e-4,
    "reservoir_sensor_drift": 11.0,
    "reservoir_sensor_gain": 1.04,
    "reservoir_sensor_offset": 11.0,
    "reservoir_viscous_leak": 6e6,
    "reservoir_volume": 1.11,
    "solenoid_slow_close": 0.03,
    "venturi_stall": 440.0,
    "viscous_leak": 1.1e5,
}
"""Typical value of each cause's first parameter, in its unit."""
DEAD_SHARE = 0.18
"""Typical dead volume of tubing and fittings, as a share of the control volume."""
_ONE_SIDED = (0.02, 0.06, 0.15, 0.3, 0.5, 0.75, 1.0, 1.4, 2.0, 3.0, 5.0, 10.0, 25.0)
_TWO_SIDED = (-6.0, -3.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 3.0, 6.0)
_EVENLY = 16


def typical(cause: Cause, rig: Rig) -> float:
    """Typical value of the cause's first parameter."""
    if cause.name == "dead_volume" and rig.cv is not None:
        return DEAD_SHARE * rig.cv.volume_L
    if cause.name in TYPICAL:
        return TYPICAL[cause.name]
    # Unknown for this cause: use a seed of its fits.
    parameter = cause.parameters[0]
    return parameter.with_effect(parameter.seeds[len(parameter.seeds) // 2])


def strengths(cause: Cause, usual: float) -> tuple[float, ...]:
    """Values of the first parameter, dense enough for linear interpolation; the typical one is among them."""
    parameter = cause.parameters[0]
    neutral = parameter.neutral
    if neutral is None or _is_threshold(parameter):
        steps = [parameter.low + i / _EVENLY * (parameter.high - parameter.low) for i in range(_EVENLY + 1)]
        return tuple(sorted({*steps, usual}))
    if parameter.low < neutral < parameter.high:
        zero = parameter.to_search(neutral)
        values = [parameter.to_model(zero + s * (parameter.to_search(usual) - zero)) for s in _TWO_SIDED]
        return _within(parameter, values)
    values = [usual / share if isinf(neutral) else share * usual for share in _ONE_SIDED]
    return (neutral, *_within(parameter, values))


def _within(parameter: Parameter, values: Sequence[float]) -> tuple[float, ...]:
    return tuple(dict.fromkeys(min(max(value, parameter.low), parameter.high) for value in values))


def _is_threshold(parameter: Parameter) -> bool:
    """True if the parameter is a threshold on a scale, not a size: such parameters have many seeds."""
    return len(parameter.seeds) > 8
