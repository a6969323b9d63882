"""The pump's stall pressure is `scale` times the nominal pressure."""

from __future__ import annotations

from dataclasses import replace

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.setup import Setup


def apply(base: Setup, scale: float) -> Setup:
    pump = base.plant.rig.pump
    if pump is None:
        return base
    return base.with_rig(pump=replace(pump, stall_pressure_kPa=scale * pump.stall_pressure_kPa))


CAUSE = Cause(
    name="pump_stall",
    what="The pump stalls at a higher or lower pressure than nominal.",
    parameters=(
        Parameter(
            "scale",
            low=0.2,
            high=5.0,
            seeds=(1.0,),
            neutral=1.0,
            logarithmic=True,
            source="from leaking membrane valves to the strongest pump of a series",
        ),
    ),
    experiment="Run the pump until the pressure no longer rises.",
    apply=apply,
    needs=("pump",),
)
