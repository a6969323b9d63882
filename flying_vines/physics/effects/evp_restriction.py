"""The inflation valve (EVP) and its supply line have `scale` times the nominal flow resistance."""

from __future__ import annotations

from dataclasses import replace

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.flow import Iso6358, Ohm
from flying_vines.physics.plant.plant import Setup
from flying_vines.physics.rig import Evp


def apply(base: Setup, scale: float) -> Setup:
    resistance = scale * base.plant.rig.evp.flow_resistance_kPa_s_per_SL
    law = base.plant.effects.evp_law
    if isinstance(law, Ohm):
        law = Ohm(scale * law.flow_resistance_kPa_s_per_SL)
    elif isinstance(law, Iso6358):
        law = replace(law, sonic_conductance_SL_per_s_kPa=law.sonic_conductance_SL_per_s_kPa / scale)
    base = base.with_rig(evp=Evp(resistance))
    return base if law is None else base.with_effects(evp_law=law)


CAUSE = Cause(
    name="evp_restriction",
    what="The flow through the inflation valve is larger or smaller than nominal.",
    parameters=(
        Parameter(
            "scale",
            low=0.1,
            high=10.0,
            seeds=(1.0,),
            neutral=1.0,
            logarithmic=True,
            source="from a valve without its orifice to a nearly clogged one",
        ),
    ),
    experiment="Open the inflation valve fully into a known volume from the full reservoir.",
    apply=apply,
    needs=("reservoir",),
)
