"""The control volume's sensor reads a constant too much."""

from __future__ import annotations

from flying_vines.identification.cause import Cause, Parameter, Readings, Values


def readings(readings: Readings, x: Values) -> Readings:
    return readings._replace(cv_kPa=readings.cv_kPa + x[0])


CAUSE = Cause(
    name="cv_sensor_offset",
    what="The control volume's sensor is off by a constant.",
    parameters=(
        Parameter(
            "offset_kPa",
            low=-50.0,
            high=50.0,
            seeds=(0.0,),
            neutral=0.0,
            source="total error band ±3.1 kPa; a wrong zero more",
        ),
    ),
    experiment="Vent the control volume, wait, and read its sensor.",
    readings=readings,
)
