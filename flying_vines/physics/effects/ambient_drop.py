"""Ambient pressure falls at a constant rate during the run, so both gauge readings rise at this rate."""

from __future__ import annotations

from functools import partial

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.ambient import Climb
from flying_vines.physics.plant.plant import Setup


def apply(base: Setup, rate_kPa_per_s: float) -> Setup:
    return base.with_effects(ambient=partial(Climb, falls_kPa_per_s=rate_kPa_per_s))


CAUSE = Cause(
    name="ambient_drop",
    what="Ambient pressure changes during the run, as in a climb.",
    parameters=(
        Parameter(
            "rate_kPa_per_s",
            low=-0.25,
            high=0.25,
            seeds=(0.0,),
            neutral=0.0,
            source="0.012 kPa per metre, at 20 m/s up or down",
        ),
    ),
    experiment="Record the ambient pressure as well; or repeat the run on the ground.",
    apply=apply,
)
