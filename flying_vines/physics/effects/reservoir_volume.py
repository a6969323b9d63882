"""The volume of the reservoir is `scale` times the nominal volume."""

from __future__ import annotations

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.plant import Setup
from flying_vines.physics.rig import Reservoir


def apply(base: Setup, scale: float) -> Setup:
    return base.with_rig(reservoir=Reservoir(scale * base.plant.rig.reservoir.volume_L))


CAUSE = Cause(
    name="reservoir_volume",
    what="The reservoir is larger or smaller than nominal.",
    parameters=(
        Parameter(
            "scale",
            low=0.4,
            high=2.5,
            seeds=(1.0,),
            neutral=1.0,
            logarithmic=True,
            source="from the next smaller vessel of a series (1, 2, 5, 10 L) to the next larger",
        ),
    ),
    experiment="Weigh the reservoir full of water; or discharge it through a known flow.",
    apply=apply,
    needs=("reservoir",),
)
