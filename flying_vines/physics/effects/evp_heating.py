"""The inflation valve (EVP) opens less as its coil warms up: its opening is multiplied by 1 − `share` · w.

w is the warmth of the coil, 0…1: dw/dt = (u − w) / τ, and w = 0 at the start of a recording.
"""

from __future__ import annotations

from functools import partial

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.plant import Setup
from flying_vines.physics.plant.valve_response import ValveMotion


def apply(base: Setup, share: float, time_constant_s: float) -> Setup:
    heating = partial(ValveMotion, heating_share=share, heating_time_s=time_constant_s)
    return base.with_effects(evp_motion=heating)


CAUSE = Cause(
    name="evp_heating",
    what="The inflation valve opens less as its coil warms up.",
    parameters=(
        Parameter(
            "share",
            low=0.0,
            high=0.6,
            seeds=(0.02, 0.2),
            neutral=0.0,
            source=(
                "copper, 0.39 % per K: a coil 50 K warmer draws 16 % less current; "
                "the valve opens up to 40 % less"
            ),
        ),
        Parameter(
            "time_constant_s",
            low=2.0,
            high=1500.0,
            seeds=(30.0,),
            neutral=None,
            logarithmic=True,
            source="heat capacity times thermal resistance: 1 J/K · 2 K/W to 40 J/K · 40 K/W",
        ),
    ),
    experiment="From a cold start, hold the inflation valve open for minutes, with the outlet open.",
    apply=apply,
)
