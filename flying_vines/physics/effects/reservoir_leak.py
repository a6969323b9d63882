"""The reservoir leaks: a flow P_r / R to ambient (P_r gauge)."""

from __future__ import annotations

from flying_vines.physics.cause import Cause, Parameter
from flying_vines.physics.plant.flow import Ohm
from flying_vines.physics.plant.setup import Setup


def apply(base: Setup, flow_resistance_kPa_s_per_SL: float) -> Setup:
    return base.with_effects(reservoir_leak=Ohm(flow_resistance_kPa_s_per_SL))


CAUSE = Cause(
    name="reservoir_leak",
    what="The reservoir loses air to ambient.",
    parameters=(
        Parameter(
            "flow_resistance_kPa_s_per_SL",
            low=100.0,
            high=1e8,
            seeds=(3e3, 3e5),
            neutral=float("inf"),
            logarithmic=True,
            source="from a hole of 2 mm (100) to a bottle that is tight for a month (1e8)",
        ),
    ),
    experiment="Fill the reservoir, shut all valves, and record its pressure for a minute.",
    law_of="a leak of the reservoir",
    apply=apply,
    needs=("reservoir",),
)
