"""The reservoir leaks through a hole: ISO 6358 with the critical ratio 0.5 of an orifice."""

from __future__ import annotations

from flying_vines.physics.cause import Cause
from flying_vines.physics.effects.orifice_leak import HOLE
from flying_vines.physics.plant.leak import orifice
from flying_vines.physics.plant.setup import Setup


def apply(base: Setup, sonic_conductance_SL_per_s_kPa: float) -> Setup:
    if sonic_conductance_SL_per_s_kPa == 0.0:
        return base.with_effects(reservoir_orifice_leak=None)
    return base.with_effects(
        reservoir_orifice_leak=orifice(sonic_conductance_SL_per_s_kPa, base.plant.rig.gas.properties)
    )


CAUSE = Cause(
    name="reservoir_orifice_leak",
    what="The reservoir loses air through a hole: the flow chokes.",
    parameters=(HOLE,),
    experiment="Fill the reservoir, shut all valves, and record its pressure until it is half empty.",
    law_of="a leak of the reservoir",
    apply=apply,
    needs=("reservoir",),
)
