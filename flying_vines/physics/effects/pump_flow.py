"""The pump's free flow is `scale` times the nominal flow."""

from __future__ import annotations

from dataclasses import replace

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.setup import Setup


def apply(base: Setup, scale: float) -> Setup:
    pump = base.plant.rig.pump
    if pump is None:
        return base
    return base.with_rig(pump=replace(pump, free_flow_SL_per_s=scale * pump.free_flow_SL_per_s))


CAUSE = Cause(
    name="pump_flow",
    what="The pump delivers more or less than nominal.",
    parameters=(
        Parameter(
            "scale",
            low=0.2,
            high=5.0,
            seeds=(1.0,),
            neutral=1.0,
            logarithmic=True,
            source="from a worn pump, or one at half voltage, to the largest pump of a series",
        ),
    ),
    experiment="Run the pump into the empty control volume from rest, several times.",
    apply=apply,
    needs=("pump",),
)
