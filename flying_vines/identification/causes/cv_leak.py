"""The control volume leaks: it also loses P_cv / R."""

from __future__ import annotations

from flying_vines.identification.cause import Cause, Parameter
from flying_vines.identification.model import Array, Flows, Moment, Numbers


def flows(numbers: Numbers, moment: Moment, flows: Flows, x: Array) -> Flows:
    loss = flows.cv_loss + moment.cv_kPa / x[0]
    return Flows(flows.inflation, flows.motive, flows.outlet, flows.reservoir_loss, loss)


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
            source="from an open outlet to a weld that holds for a week",
        ),
    ),
    experiment="Inflate the control volume, shut all valves, and record its pressure for a minute.",
    flows=flows,
)
