"""A sensor reads `gain` times the pressure, plus an offset that may drift linearly from the start of the
recording on; the control volume's may also follow with a first-order lag.
"""

from __future__ import annotations

from functools import partial

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.plant import Setup
from flying_vines.physics.rig import VESSELS, Vessel


def _apply_gain(vessel: Vessel, base: Setup, gain: float) -> Setup:
    return base.with_sensor(vessel, gain=gain)


def _apply_offset(vessel: Vessel, base: Setup, offset_kPa: float) -> Setup:
    return base.with_sensor(vessel, offset_kPa=offset_kPa)


def _apply_drift(vessel: Vessel, base: Setup, rate_kPa_per_min: float) -> Setup:
    return base.with_sensor(vessel, drift_kPa_per_min=rate_kPa_per_min)


def _apply_lag(base: Setup, time_constant_s: float) -> Setup:
    return base.with_sensor("cv", time_constant_s=time_constant_s)


def _gain(vessel: Vessel, experiment: str) -> Cause:
    source = "3.3 V in place of 5 V on a ratiometric sensor: 0.66, or 1.5; a voltage divider: about 10 %"
    return Cause(
        name=f"{vessel}_sensor_gain",
        what=f"The {VESSELS[vessel]}'s sensor has a wrong scale.",
        parameters=(
            Parameter("gain", low=0.6, high=1.6, seeds=(1.0,), neutral=1.0, logarithmic=True, source=source),
        ),
        experiment=experiment,
        apply=partial(_apply_gain, vessel),
        needs=(vessel,),
    )


def _either_way(name: str, vessel: Vessel, most: float, of_largest: float, source: str) -> Parameter:
    return Parameter(
        name,
        low=-most,
        high=most,
        seeds=(0.0,),
        neutral=0.0,
        of_largest=(vessel, of_largest),
        source=source,
    )


def _offset(vessel: Vessel, most_kPa: float, source: str, experiment: str) -> Cause:
    return Cause(
        name=f"{vessel}_sensor_offset",
        what=f"The {VESSELS[vessel]}'s sensor is off by a constant.",
        parameters=(_either_way("offset_kPa", vessel, most_kPa, 0.3, source),),
        experiment=experiment,
        apply=partial(_apply_offset, vessel),
        needs=(vessel,),
    )


def _drift(vessel: Vessel, most_kPa_per_min: float, of_largest: float, source: str, experiment: str) -> Cause:
    return Cause(
        name=f"{vessel}_sensor_drift",
        what=f"The {VESSELS[vessel]}'s sensor drifts.",
        parameters=(_either_way("rate_kPa_per_min", vessel, most_kPa_per_min, of_largest, source),),
        experiment=experiment,
        apply=partial(_apply_drift, vessel),
        needs=(vessel,),
    )


CV_GAIN = _gain("cv", "Hold a pressure, and compare the reading with a calibrated gauge.")
RESERVOIR_GAIN = _gain("reservoir", "Fill the reservoir, and compare the reading with a calibrated gauge.")
CV_OFFSET = _offset(
    "cv",
    20.0,
    "total error band ±3.1 kPa of 207; a zero that was never set: 10 % of the span",
    "Vent the control volume, wait, and read its sensor.",
)
RESERVOIR_OFFSET = _offset(
    "reservoir",
    75.0,
    "total error band ±22.5 kPa of 1500; a zero that was never set: 5 % of the span",
    "Empty the reservoir, wait, and read its sensor.",
)
CV_DRIFT = _drift(
    "cv",
    10.0,
    0.3,
    "2 % of the span in a minute of warming up: 4 kPa of 200",
    "Vent the control volume, switch the sensor on, and record it for some minutes.",
)
RESERVOIR_DRIFT = _drift(
    "reservoir",
    50.0,
    0.05,
    "2 % of the span in a minute of warming up: 30 kPa of 1500",
    "Empty the reservoir, switch the sensor on, and record it for some minutes.",
)
CV_LAG = Cause(
    name="cv_sensor_lag",
    what="The control volume's sensor follows slowly.",
    parameters=(
        Parameter(
            "time_constant_s",
            low=1e-4,
            high=2.0,
            seeds=(0.003, 0.05),
            neutral=0.0,
            logarithmic=True,
            source="sensor 1 ms; with a filter or a thin hose up to 1 s",
        ),
    ),
    experiment="Inflate quickly, shut all valves at once, and record every millisecond.",
    apply=_apply_lag,
    needs=("cv",),
)
