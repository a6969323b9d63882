"""The opening of the inflation valve (EVP) follows its command with a first-order lag."""

from __future__ import annotations

from functools import partial

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.plant import Setup
from flying_vines.physics.plant.valve_response import ValveMotion


def apply(base: Setup, time_constant_s: float) -> Setup:
    return base.with_effects(evp_motion=partial(ValveMotion, time_constant_s=time_constant_s))


CAUSE = Cause(
    name="evp_lag",
    what="The inflation valve follows its command slowly.",
    parameters=(
        Parameter(
            "time_constant_s",
            low=1e-4,
            high=2.0,
            seeds=(0.003, 0.05),
            neutral=0.0,
            logarithmic=True,
            source="small proportional valves: 5 to 30 ms; a pump's run-up 0.5 s; a motor-driven valve 2 s",
        ),
    ),
    experiment="Open and shut the inflation valve in pulses of 0.05 to 0.5 s.",
    apply=apply,
)
