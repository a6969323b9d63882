"""Gas in the reservoir cools as it expands, and the wall warms it again:

dθ/dt = −(γ−1) θ² α ΣQ/(V p) + (1 − θ)/τ      dP/dt = −γ θ α ΣQ/V + (p/θ)(1 − θ)/τ

p is the absolute pressure, θ the temperature of the gas over that of ambient air.
"""

from __future__ import annotations

from functools import partial

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.plant import Setup
from flying_vines.physics.plant.volume import Wall


def apply(base: Setup, time_constant_s: float) -> Setup:
    if time_constant_s == 0.0:
        return base.with_effects(reservoir_wall=None)
    return base.with_effects(reservoir_wall=partial(Wall, time_constant_s=time_constant_s))


CAUSE = Cause(
    name="reservoir_cooling",
    what="Gas in the reservoir cools as it expands, and warms up again at the wall.",
    parameters=(
        Parameter(
            "time_constant_s",
            low=0.02,
            high=600.0,
            seeds=(0.1, 10.0, 300.0),
            neutral=0.0,
            logarithmic=True,
            source=(
                "full of fine wire, with conduction d²/(π² a) over 2 mm of air: 0.02 s; a 2 L bottle with "
                "natural convection: about 10 s; a 50 L cylinder: minutes"
            ),
        ),
    ),
    experiment=(
        "Let air out for some seconds, shut all valves, and record for half a minute: "
        "cooled gas makes the pressure rise again."
    ),
    apply=apply,
    needs=("reservoir",),
)
