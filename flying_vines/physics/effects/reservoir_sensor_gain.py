"""The reservoir's sensor reads `gain` times the true pressure."""

from __future__ import annotations

from dataclasses import replace

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.setup import Setup


def apply(base: Setup, gain: float) -> Setup:
    return replace(base, reservoir_sensor=replace(base.reservoir_sensor, gain=gain))


CAUSE = Cause(
    name="reservoir_sensor_gain",
    what="The reservoir's sensor has a wrong scale.",
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
    experiment="Fill the reservoir, and compare the reading with a calibrated gauge.",
    apply=apply,
    needs=("reservoir",),
)
