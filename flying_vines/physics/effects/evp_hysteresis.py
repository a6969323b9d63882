"""The inflation valve (EVP) has backlash of full width w: its opening stays within w/2 of the command, and
only moves when it must. A command of 0 shuts the valve and resets the backlash.
"""

from __future__ import annotations

from functools import partial

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.plant import Setup
from flying_vines.physics.plant.valve_response import ValveMotion


def apply(base: Setup, width: float) -> Setup:
    return base.with_effects(evp_motion=partial(ValveMotion, backlash_width=width))


CAUSE = Cause(
    name="evp_hysteresis",
    what="The inflation valve has hysteresis: it opens less on the way up than on the way down.",
    parameters=(
        Parameter(
            "width",
            low=0.0,
            high=0.4,
            seeds=(0.003, 0.05, 0.15),
            neutral=0.0,
            source="manufacturers state about 0.1, simple valves 0.2; more with a worn valve",
        ),
    ),
    experiment="Raise the opening of the inflation valve in small steps and lower it again the same way.",
    apply=apply,
)
