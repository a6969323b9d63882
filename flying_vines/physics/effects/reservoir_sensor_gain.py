"""The reservoir's sensor reads gain times what it should."""

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
            low=0.5,
            high=2.0,
            seeds=(1.0,),
            neutral=1.0,
            logarithmic=True,
            source="a wrong supply or divider: some 10 %",
        ),
    ),
    experiment="Fill to a pressure that a gauge of known accuracy shows as well.",
    apply=apply,
)
