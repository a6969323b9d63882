"""Gas in the control volume warms as it is compressed, and cools again at the wall:

dP/dt = γ α (Q_in − θ Q_out)/V − (p/θ)(θ − 1)/τ      air enters at ambient temperature

p is the absolute pressure, θ the temperature of the gas over that of ambient air.
"""

from __future__ import annotations

from functools import partial

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.plant import Setup
from flying_vines.physics.plant.volume import Wall


def apply(base: Setup, time_constant_s: float) -> Setup:
    if time_constant_s == 0.0:
        return base.with_effects(cv_wall=None)
    return base.with_effects(cv_wall=partial(Wall, time_constant_s=time_constant_s, inflow_at_ambient=True))


CAUSE = Cause(
    name="cv_heating",
    what="Gas in the control volume warms as it is compressed, and cools again at the wall.",
    parameters=(
        Parameter(
            "time_constant_s",
            low=0.02,
            high=600.0,
            seeds=(0.05, 1.0, 30.0),
            neutral=0.0,
            logarithmic=True,
            source=(
                "conduction d²/(π² a) across 2 mm of air: 0.02 s; natural convection: "
                "0.3 to 10 s in 0.1 to 1 L, minutes in 100 L"
            ),
        ),
    ),
    experiment=(
        "Inflate the control volume as fast as possible, shut all valves, and record for half a minute: "
        "as the gas cools, the pressure falls to a new level."
    ),
    apply=apply,
    needs=("cv",),
)
