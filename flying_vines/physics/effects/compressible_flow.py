"""Both proportional valves follow ISO 6358 and choke:

    Q = u C p₁ φ(p₂/p₁),   φ = 1 for p₂/p₁ ≤ b, else √(1 − ((p₂/p₁ − b)/(1 − b))²)

Pressures are absolute. Above p₂/p₁ = 0.999 φ falls linearly to 0, as in MathWorks' "Orifice ISO 6358 (G)".
With the square root alone, a fit's derivatives of the pressure in an almost empty vessel would be noisy. C is
chosen so that a fully open valve has the flow of Ohm's law from 690 to 0 kPa gauge at 101.325 kPa ambient.
There is no backflow. ISO 6358-1:2013.
"""

from __future__ import annotations

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.flow import Iso6358, choked_law
from flying_vines.physics.plant.plant import Setup

_MATCHED_KPA = 690.0


def apply(base: Setup, critical_pressure_ratio: float) -> Setup:
    rig = base.plant.rig

    def law(flow_resistance_kPa_s_per_SL: float) -> Iso6358:
        gas = rig.gas.properties
        return choked_law(flow_resistance_kPa_s_per_SL, _MATCHED_KPA, critical_pressure_ratio, gas)

    return base.with_effects(
        evp_law=law(rig.evp.flow_resistance_kPa_s_per_SL),
        dvp_law=law(rig.dvp.flow_resistance_kPa_s_per_SL),
    )


CRITICAL_PRESSURE_RATIO = Parameter(
    "critical_pressure_ratio",
    low=0.0,
    high=0.7,
    seeds=(0.3,),
    neutral=None,
    typical=(0.35, 0.12),
    source=("ISO 6358: 0.5 for an orifice, 0.2 to 0.4 with fittings, 0 for long tubes; an ideal nozzle 0.53"),
)
"""b of ISO 6358."""

CAUSE = Cause(
    name="compressible_flow",
    what="The proportional valves choke, as compressible flow does.",
    parameters=(CRITICAL_PRESSURE_RATIO,),
    experiment="Discharge the reservoir from full to empty through the open inflation valve.",
    apply=apply,
    needs=("reservoir",),
    is_flow_law=True,
)
