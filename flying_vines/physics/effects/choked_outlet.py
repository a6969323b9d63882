"""The outlet of a chamber with a pump follows ISO 6358 and chokes:

    Q = s C p₁ φ(p₂/p₁)

Pressures are absolute, φ is that of `compressible_flow`. C is chosen so that the open outlet has the flow of
Ohm's law from 100 to 0 kPa gauge at 101.325 kPa ambient. Only for rigs with a pump: the vine of a rig with a
reservoir stays below 21 kPa gauge, where its outlet does not choke.
"""

from __future__ import annotations

from flying_vines.physics.cause import Cause
from flying_vines.physics.effects.compressible_flow import CRITICAL_PRESSURE_RATIO
from flying_vines.physics.plant.flow import choked_law
from flying_vines.physics.plant.plant import Setup

_MATCHED_KPA = 100.0


def apply(base: Setup, critical_pressure_ratio: float) -> Setup:
    rig = base.plant.rig
    law = choked_law(
        rig.solenoid.flow_resistance_kPa_s_per_SL,
        _MATCHED_KPA,
        critical_pressure_ratio,
        rig.gas.properties,
        one_way=False,
    )
    return base.with_effects(solenoid_law=law)


CAUSE = Cause(
    name="choked_outlet",
    what="The outlet chokes, as compressible flow does.",
    parameters=(CRITICAL_PRESSURE_RATIO,),
    experiment="Vent the control volume from its highest pressure.",
    apply=apply,
    needs=("pump",),
    is_flow_law=True,
)
