"""The control volume's sensor has a constant offset."""

from __future__ import annotations

from dataclasses import replace

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.setup import Setup


def apply(base: Setup, offset_kPa: float) -> Setup:
    return replace(base, cv_sensor=replace(base.cv_sensor, offset_kPa=offset_kPa))


CAUSE = Cause(
    name="cv_sensor_offset",
    what="The control volume's sensor is off by a constant.",
    parameters=(
        Parameter(
            "offset_kPa",
            low=-20.0,
            high=20.0,
            seeds=(0.0,),
            neutral=0.0,
            of_largest=("cv", 0.3),
            source="total error band ±3.1 kPa of 207; a zero that was never set: 10 % of the span",
        ),
    ),
    experiment="Vent the control volume, wait, and read its sensor.",
    apply=apply,
    needs=("cv",),
)
