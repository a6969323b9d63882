"""The control volume's sensor follows the pressure with a first-order lag."""

from __future__ import annotations

from dataclasses import replace

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.setup import Setup


def apply(base: Setup, time_constant_s: float) -> Setup:
    return replace(base, cv_sensor=replace(base.cv_sensor, time_constant_s=time_constant_s))


CAUSE = Cause(
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
    apply=apply,
    needs=("cv",),
)
