"""Ambient pressure falls at a constant rate during the run, so both gauge readings rise at this rate."""

from __future__ import annotations

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.ambient import Climb
from flying_vines.physics.plant.setup import Setup


def apply(base: Setup, rate_kPa_per_s: float) -> Setup:
    return base.with_effects(ambient=Climb(rate_kPa_per_s))


CAUSE = Cause(
    name="ambient_drop",
    what="Ambient pressure changes during the run, as in a climb.",
    parameters=(
        Parameter(
            "rate_kPa_per_s",
            low=-1.0,
            high=2.0,
            seeds=(0.0,),
            neutral=0.0,
            source="0.012 kPa per metre: a fast climb of a drone gives 0.2 kPa/s",
        ),
    ),
    experiment="Record the ambient pressure as well; or repeat the run on the ground.",
    apply=apply,
)
