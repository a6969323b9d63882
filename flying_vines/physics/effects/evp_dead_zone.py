"""The inflation valve (EVP) only opens above u₀: max(0, (u − u₀)/(1 − u₀)). A full command opens it fully."""

from __future__ import annotations

from functools import partial

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.plant import Setup
from flying_vines.physics.plant.valve_response import ValveMotion


def apply(base: Setup, opening: float) -> Setup:
    return base.with_effects(evp_motion=partial(ValveMotion, dead_opening=opening))


CAUSE = Cause(
    name="evp_dead_zone",
    what="The inflation valve stays shut until its command has passed a dead zone.",
    parameters=(
        Parameter(
            "opening",
            low=0.0,
            high=0.8,
            seeds=(0.002, 0.05, 0.2),
            neutral=0.0,
            source=(
                "small proportional valves: 0.25 to 0.45 of full current; a pump's motor starts at up to 0.7"
            ),
        ),
    ),
    experiment="Raise the opening of the inflation valve from 0 to 1 in small steps, a second each.",
    apply=apply,
)
