"""The control volume leaks: a flow P_cv / R to ambient (P_cv gauge)."""

from __future__ import annotations

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.flow import Ohm
from flying_vines.physics.plant.setup import Setup


def apply(base: Setup, flow_resistance_kPa_s_per_SL: float) -> Setup:
    return base.with_effects(cv_leak=Ohm(flow_resistance_kPa_s_per_SL))


CAUSE = Cause(
    name="cv_leak",
    what="The control volume loses air to ambient.",
    parameters=(
        Parameter(
            "flow_resistance_kPa_s_per_SL",
            low=10.0,
            high=1e8,
            seeds=(3e2, 1e4, 1e6),
            neutral=float("inf"),
            logarithmic=True,
            source="from a hole of 5 mm (10) to a weld that keeps its pressure for a week (1e8)",
        ),
    ),
    experiment="Inflate the control volume, shut all valves, and record its pressure for a minute.",
    law_of="a leak of the control volume",
    apply=apply,
    needs=("cv",),
)
