"""The reservoir's sensor has a constant offset."""

from __future__ import annotations

from dataclasses import replace

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.setup import Setup


def apply(base: Setup, offset_kPa: float) -> Setup:
    return replace(base, reservoir_sensor=replace(base.reservoir_sensor, offset_kPa=offset_kPa))


CAUSE = Cause(
    name="reservoir_sensor_offset",
    what="The reservoir's sensor is off by a constant.",
    parameters=(
        Parameter(
            "offset_kPa",
            low=-75.0,
            high=75.0,
            seeds=(0.0,),
            neutral=0.0,
            of_largest=("reservoir", 0.3),
            source="total error band ±22.5 kPa of 1500; a zero that was never set: 5 % of the span",
        ),
    ),
    experiment="Empty the reservoir, wait, and read its sensor.",
    apply=apply,
    needs=("reservoir",),
)
