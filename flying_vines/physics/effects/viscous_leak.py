"""The control volume leaks through a narrow gap: a flow (p² − p_a²) / C, absolute pressures, laminar."""

from __future__ import annotations

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.leak import Viscous
from flying_vines.physics.plant.setup import Setup


def apply(base: Setup, conductance_constant_kPa2_s_per_SL: float) -> Setup:
    return base.with_effects(cv_viscous_leak=Viscous(conductance_constant_kPa2_s_per_SL))


CAUSE = Cause(
    name="viscous_leak",
    what="The control volume loses air through a narrow gap: laminar flow.",
    parameters=(
        Parameter(
            "conductance_constant_kPa2_s_per_SL",
            low=2e3,
            high=5e10,
            seeds=(1e5, 3e6, 3e8),
            neutral=float("inf"),
            logarithmic=True,
            source="C = R (p + p_a), with R of cv_leak (10 to 1e8), and p + p_a from 200 to 500 kPa",
        ),
    ),
    experiment="Inflate the control volume to its highest pressure, shut all valves, and let it empty.",
    law_of="a leak of the control volume",
    apply=apply,
    needs=("cv",),
)
