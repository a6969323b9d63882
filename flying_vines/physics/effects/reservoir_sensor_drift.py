"""The reservoir's sensor drifts: its offset changes linearly from the start of the recording on."""

from __future__ import annotations

from dataclasses import replace

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.setup import Setup


def apply(base: Setup, rate_kPa_per_min: float) -> Setup:
    return replace(base, reservoir_sensor=replace(base.reservoir_sensor, drift_kPa_per_min=rate_kPa_per_min))


CAUSE = Cause(
    name="reservoir_sensor_drift",
    what="The reservoir's sensor drifts.",
    parameters=(
        Parameter(
            "rate_kPa_per_min",
            low=-50.0,
            high=50.0,
            seeds=(0.0,),
            neutral=0.0,
            of_largest=("reservoir", 0.05),
            source="2 % of the span in a minute of warming up: 30 kPa of 1500",
        ),
    ),
    experiment="Empty the reservoir, switch the sensor on, and record it for some minutes.",
    apply=apply,
    needs=("reservoir",),
)
