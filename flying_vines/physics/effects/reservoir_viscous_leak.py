"""The reservoir leaks through a narrow gap: a flow (p² − p_a²) / C, absolute pressures, laminar."""

from __future__ import annotations

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.leak import Viscous
from flying_vines.physics.plant.setup import Setup


def apply(base: Setup, conductance_constant_kPa2_s_per_SL: float) -> Setup:
    return base.with_effects(reservoir_viscous_leak=Viscous(conductance_constant_kPa2_s_per_SL))


CAUSE = Cause(
    name="reservoir_viscous_leak",
    what="The reservoir loses air through a narrow gap: laminar flow.",
    parameters=(
        Parameter(
            "conductance_constant_kPa2_s_per_SL",
            low=5e4,
            high=1e11,
            seeds=(3e6, 3e8),
            neutral=float("inf"),
            logarithmic=True,
            source="C = R (p + p_a), with R of reservoir_leak (100 to 1e8), and p + p_a from 500 to 1000 kPa",
        ),
    ),
    experiment="Fill the reservoir, shut all valves, and record its pressure until it is half empty.",
    law_of="a leak of the reservoir",
    apply=apply,
    needs=("reservoir",),
)
