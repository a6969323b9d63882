"""The control volume's sensor drifts: its offset changes linearly from the start of the recording on."""

from __future__ import annotations

from dataclasses import replace

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.setup import Setup


def apply(base: Setup, rate_kPa_per_min: float) -> Setup:
    return replace(base, cv_sensor=replace(base.cv_sensor, drift_kPa_per_min=rate_kPa_per_min))


CAUSE = Cause(
    name="cv_sensor_drift",
    what="The control volume's sensor drifts.",
    parameters=(
        Parameter(
            "rate_kPa_per_min",
            low=-10.0,
            high=10.0,
            seeds=(0.0,),
            neutral=0.0,
            of_largest=("cv", 0.3),
            source="2 % of the span in a minute of warming up: 4 kPa of 200",
        ),
    ),
    experiment="Vent the control volume, switch the sensor on, and record it for some minutes.",
    apply=apply,
    needs=("cv",),
)
