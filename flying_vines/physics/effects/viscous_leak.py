"""A vessel leaks through a narrow gap: a flow (p² − p_a²) / C, absolute pressures, laminar."""

from __future__ import annotations

from functools import partial

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.leak import Viscous
from flying_vines.physics.plant.plant import Setup
from flying_vines.physics.rig import Vessel


def _apply(vessel: Vessel, base: Setup, conductance_constant_kPa2_s_per_SL: float) -> Setup:
    return base.with_effects(**{f"{vessel}_viscous_leak": Viscous(conductance_constant_kPa2_s_per_SL)})


def _constant(low: float, high: float, seeds: tuple[float, ...], source: str) -> Parameter:
    return Parameter(
        "conductance_constant_kPa2_s_per_SL",
        low=low,
        high=high,
        seeds=seeds,
        neutral=float("inf"),
        logarithmic=True,
        source=source,
    )


CV = Cause(
    name="viscous_leak",
    what="The control volume loses air through a narrow gap: laminar flow.",
    parameters=(
        _constant(
            2e3,
            5e10,
            (1e5, 3e6, 3e8),
            "C = R (p + p_a), with R of cv_leak (10 to 1e8), and p + p_a from 200 to 500 kPa",
        ),
    ),
    experiment="Inflate the control volume to its highest pressure, shut all valves, and let it empty.",
    law_of="a leak of the control volume",
    apply=partial(_apply, "cv"),
    needs=("cv",),
)
RESERVOIR = Cause(
    name="reservoir_viscous_leak",
    what="The reservoir loses air through a narrow gap: laminar flow.",
    parameters=(
        _constant(
            5e4,
            1e11,
            (3e6, 3e8),
            "C = R (p + p_a), with R of reservoir_leak (100 to 1e8), and p + p_a from 500 to 1000 kPa",
        ),
    ),
    experiment="Fill the reservoir, shut all valves, and record its pressure until it is half empty.",
    law_of="a leak of the reservoir",
    apply=partial(_apply, "reservoir"),
    needs=("reservoir",),
)
