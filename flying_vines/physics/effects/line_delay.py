"""The inflation valve follows its command after a constant delay."""

from __future__ import annotations

from functools import partial

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.plant import Setup
from flying_vines.physics.plant.valve_response import ValveMotion


def apply(base: Setup, delay_s: float) -> Setup:
    return base.with_effects(evp_motion=partial(ValveMotion, delay_s=delay_s))


CAUSE = Cause(
    name="line_delay",
    what="The inflation valve acts after a pure delay.",
    parameters=(
        Parameter(
            "delay_s",
            low=0.0,
            high=1.0,
            seeds=(0.001, 0.02, 0.08),
            neutral=0.0,
            source=("valve 2 to 5 ms, drivers and buses up to about 100 ms, a computer's loop up to 1 s"),
        ),
    ),
    experiment="Open and shut the inflation valve in pulses of 0.05 to 0.5 s.",
    apply=apply,
)
