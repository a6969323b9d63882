"""The reservoir's sensor reads a constant too much."""

from __future__ import annotations

from flying_vines.identification.cause import Cause, Parameter, Readings, Values


def readings(readings: Readings, x: Values) -> Readings:
    return readings._replace(reservoir_kPa=readings.reservoir_kPa + x[0])


CAUSE = Cause(
    name="reservoir_sensor_offset",
    what="The reservoir's sensor is off by a constant.",
    parameters=(
        Parameter(
            "offset_kPa",
            low=-200.0,
            high=200.0,
            seeds=(0.0,),
            neutral=0.0,
            source="total error band ±22.5 kPa; a wrong zero more",
        ),
    ),
    experiment="Empty the reservoir, wait, and read its sensor.",
    readings=readings,
)
