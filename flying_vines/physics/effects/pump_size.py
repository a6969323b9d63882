"""The pump's free flow, or its stall pressure, is `scale` times the nominal one."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.plant import Setup


def _apply(number: str, base: Setup, scale: float) -> Setup:
    pump = base.plant.rig.pump
    if pump is None:
        return base
    return base.with_rig(pump=replace(pump, **{number: scale * getattr(pump, number)}))


def _scale(source: str) -> Parameter:
    return Parameter("scale", low=0.2, high=5.0, seeds=(1.0,), neutral=1.0, logarithmic=True, source=source)


FLOW = Cause(
    name="pump_flow",
    what="The pump delivers more or less than nominal.",
    parameters=(_scale("from a worn pump, or one at half voltage, to the largest pump of a series"),),
    experiment="Run the pump into the empty control volume from rest, several times.",
    apply=partial(_apply, "free_flow_SL_per_s"),
    needs=("pump",),
)
STALL = Cause(
    name="pump_stall",
    what="The pump stalls at a higher or lower pressure than nominal.",
    parameters=(_scale("from leaking membrane valves to the strongest pump of a series"),),
    experiment="Run the pump until the pressure no longer rises.",
    apply=partial(_apply, "stall_pressure_kPa"),
    needs=("pump",),
)
