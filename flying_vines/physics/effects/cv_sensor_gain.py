"""The control volume's sensor reads `gain` times the true pressure."""

from __future__ import annotations

from dataclasses import replace

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.setup import Setup


def apply(base: Setup, gain: float) -> Setup:
    return replace(base, cv_sensor=replace(base.cv_sensor, gain=gain))


CAUSE = Cause(
    name="cv_sensor_gain",
    what="The control volume's sensor has a wrong scale.",
    parameters=(
        Parameter(
            "gain",
            low=0.6,
            high=1.6,
            seeds=(1.0,),
            neutral=1.0,
            logarithmic=True,
            source=(
                "3.3 V in place of 5 V on a ratiometric sensor: 0.66, or 1.5; a voltage divider: about 10 %"
            ),
        ),
    ),
    experiment="Hold a pressure, and compare the reading with a calibrated gauge.",
    apply=apply,
    needs=("cv",),
)
