"""A vessel leaks through a hole: ISO 6358 with the critical ratio 0.5 of an orifice."""

from __future__ import annotations

from functools import partial

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.leak import orifice
from flying_vines.physics.plant.plant import Setup
from flying_vines.physics.rig import Vessel


def _apply(vessel: Vessel, base: Setup, sonic_conductance_SL_per_s_kPa: float) -> Setup:
    hole = None
    if sonic_conductance_SL_per_s_kPa > 0.0:
        hole = orifice(sonic_conductance_SL_per_s_kPa, base.plant.rig.gas.properties)
    return base.with_effects(**{f"{vessel}_orifice_leak": hole})


_HOLE = Parameter(
    "sonic_conductance_SL_per_s_kPa",
    low=1e-9,
    high=0.03,
    seeds=(1e-7, 3e-6, 1e-4),
    neutral=0.0,
    logarithmic=True,
    source="1.3e-3 for each mm² of a sharp hole: from 1 µm across to 5 mm",
)

CV = Cause(
    name="orifice_leak",
    what="The control volume loses air through a hole: the flow chokes.",
    parameters=(_HOLE,),
    experiment="Inflate the control volume to its highest pressure, shut all valves, and let it empty.",
    law_of="a leak of the control volume",
    apply=partial(_apply, "cv"),
    needs=("cv",),
)
RESERVOIR = Cause(
    name="reservoir_orifice_leak",
    what="The reservoir loses air through a hole: the flow chokes.",
    parameters=(_HOLE,),
    experiment="Fill the reservoir, shut all valves, and record its pressure until it is half empty.",
    law_of="a leak of the reservoir",
    apply=partial(_apply, "reservoir"),
    needs=("reservoir",),
)
