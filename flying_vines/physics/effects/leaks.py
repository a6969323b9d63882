"""A vessel leaks to ambient, by one of three laws. P is gauge pressure, p and p_a are absolute.

P / R                   Ohm's law
(p² − p_a²) / C         a narrow gap, laminar
ISO 6358                a hole: it chokes; with the critical ratio 0.5 of an orifice
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.flow import Ohm
from flying_vines.physics.plant.leak import Viscous, orifice
from flying_vines.physics.plant.plant import Setup
from flying_vines.physics.rig import VESSELS, Vessel


def _ohmic(vessel: Vessel, base: Setup, flow_resistance_kPa_s_per_SL: float) -> Setup:
    return base.with_effects(**{f"{vessel}_leak": Ohm(flow_resistance_kPa_s_per_SL)})


def _viscous(vessel: Vessel, base: Setup, conductance_constant_kPa2_s_per_SL: float) -> Setup:
    return base.with_effects(**{f"{vessel}_viscous_leak": Viscous(conductance_constant_kPa2_s_per_SL)})


def _hole(vessel: Vessel, base: Setup, sonic_conductance_SL_per_s_kPa: float) -> Setup:
    hole = None
    if sonic_conductance_SL_per_s_kPa > 0.0:
        hole = orifice(sonic_conductance_SL_per_s_kPa, base.plant.rig.gas.properties)
    return base.with_effects(**{f"{vessel}_orifice_leak": hole})


def _leak(
    name: str, vessel: Vessel, how: str, law: Callable[..., Setup], parameter: Parameter, experiment: str
) -> Cause:
    return Cause(
        name=name,
        what=f"The {VESSELS[vessel]} loses air {how}.",
        parameters=(parameter,),
        experiment=experiment,
        law_of=f"a leak of the {VESSELS[vessel]}",
        apply=partial(law, vessel),
        needs=(vessel,),
    )


def _resistance(low: float, seeds: tuple[float, ...], source: str) -> Parameter:
    return Parameter("flow_resistance_kPa_s_per_SL", low, 1e8, seeds, float("inf"), source, logarithmic=True)


def _constant(low: float, high: float, seeds: tuple[float, ...], source: str) -> Parameter:
    return Parameter(
        "conductance_constant_kPa2_s_per_SL", low, high, seeds, float("inf"), source, logarithmic=True
    )


_HOLE = Parameter(
    "sonic_conductance_SL_per_s_kPa",
    low=1e-9,
    high=0.03,
    seeds=(1e-7, 3e-6, 1e-4),
    neutral=0.0,
    logarithmic=True,
    source="1.3e-3 for each mm² of a sharp hole: from 1 µm across to 5 mm",
)
_LET_IT_EMPTY = "Inflate the control volume to its highest pressure, shut all valves, and let it empty."
_HALF_EMPTY = "Fill the reservoir, shut all valves, and record its pressure until it is half empty."

CV_OHMIC = _leak(
    "cv_leak",
    "cv",
    "to ambient",
    _ohmic,
    _resistance(
        10.0, (3e2, 1e4, 1e6), "from a hole of 5 mm (10) to a weld that keeps its pressure for a week (1e8)"
    ),
    "Inflate the control volume, shut all valves, and record its pressure for a minute.",
)
RESERVOIR_OHMIC = _leak(
    "reservoir_leak",
    "reservoir",
    "to ambient",
    _ohmic,
    _resistance(100.0, (3e3, 3e5), "from a hole of 2 mm (100) to a vessel that is tight for a month (1e8)"),
    "Fill the reservoir, shut all valves, and record its pressure for a minute.",
)
CV_VISCOUS = _leak(
    "viscous_leak",
    "cv",
    "through a narrow gap: laminar flow",
    _viscous,
    _constant(
        2e3,
        5e10,
        (1e5, 3e6, 3e8),
        "C = R (p + p_a), with R of cv_leak (10 to 1e8), and p + p_a from 200 to 500 kPa",
    ),
    _LET_IT_EMPTY,
)
RESERVOIR_VISCOUS = _leak(
    "reservoir_viscous_leak",
    "reservoir",
    "through a narrow gap: laminar flow",
    _viscous,
    _constant(
        5e4,
        1e11,
        (3e6, 3e8),
        "C = R (p + p_a), with R of reservoir_leak (100 to 1e8), and p + p_a from 500 to 1000 kPa",
    ),
    _HALF_EMPTY,
)
CV_HOLE = _leak("orifice_leak", "cv", "through a hole: the flow chokes", _hole, _HOLE, _LET_IT_EMPTY)
RESERVOIR_HOLE = _leak(
    "reservoir_orifice_leak", "reservoir", "through a hole: the flow chokes", _hole, _HOLE, _HALF_EMPTY
)
