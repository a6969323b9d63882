"""The solenoid closes some time after its command."""

from __future__ import annotations

from functools import partial

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.plant import Setup
from flying_vines.physics.plant.valve_response import SolenoidTiming


def apply(base: Setup, delay_s: float) -> Setup:
    return base.with_effects(solenoid_timing=partial(SolenoidTiming, closing_s=delay_s))


CAUSE = Cause(
    name="solenoid_slow_close",
    what="The solenoid closes late.",
    parameters=(
        Parameter(
            "delay_s",
            low=0.0,
            high=0.5,
            seeds=(0.001, 0.02, 0.08),
            neutral=0.0,
            source="10 to 40 ms, with a fly-back diode up to 100 ms; more if it sticks",
        ),
    ),
    experiment="Vent the inflated control volume in pulses of 0.05 to 0.5 s.",
    apply=apply,
)
