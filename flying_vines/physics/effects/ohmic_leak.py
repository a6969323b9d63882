"""A vessel leaks: a flow P / R to ambient (P gauge)."""

from __future__ import annotations

from functools import partial

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.flow import Ohm
from flying_vines.physics.plant.plant import Setup
from flying_vines.physics.rig import Vessel


def _apply(vessel: Vessel, base: Setup, flow_resistance_kPa_s_per_SL: float) -> Setup:
    return base.with_effects(**{f"{vessel}_leak": Ohm(flow_resistance_kPa_s_per_SL)})


def _resistance(low: float, seeds: tuple[float, ...], source: str) -> Parameter:
    return Parameter(
        "flow_resistance_kPa_s_per_SL",
        low=low,
        high=1e8,
        seeds=seeds,
        neutral=float("inf"),
        logarithmic=True,
        source=source,
    )


CV = Cause(
    name="cv_leak",
    what="The control volume loses air to ambient.",
    parameters=(
        _resistance(
            10.0,
            (3e2, 1e4, 1e6),
            "from a hole of 5 mm (10) to a weld that keeps its pressure for a week (1e8)",
        ),
    ),
    experiment="Inflate the control volume, shut all valves, and record its pressure for a minute.",
    law_of="a leak of the control volume",
    apply=partial(_apply, "cv"),
    needs=("cv",),
)
RESERVOIR = Cause(
    name="reservoir_leak",
    what="The reservoir loses air to ambient.",
    parameters=(
        _resistance(
            100.0, (3e3, 3e5), "from a hole of 2 mm (100) to a vessel that is tight for a month (1e8)"
        ),
    ),
    experiment="Fill the reservoir, shut all valves, and record its pressure for a minute.",
    law_of="a leak of the reservoir",
    apply=partial(_apply, "reservoir"),
    needs=("reservoir",),
)
