"""The reservoir leaks: it also loses P_r / R."""

from __future__ import annotations

from flying_vines.identification.cause import Cause, Parameter
from flying_vines.identification.model import Array, Flows, Moment, Numbers


def flows(numbers: Numbers, moment: Moment, flows: Flows, x: Array) -> Flows:
    loss = flows.reservoir_loss + moment.reservoir_kPa / x[0]
    return Flows(flows.inflation, flows.motive, flows.outlet, loss, flows.cv_loss)


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
            source="from a tenth of the inflation valve to a bottle that holds for a month",
        ),
    ),
    experiment="Fill the reservoir, shut all valves, and record its pressure for a minute.",
    flows=flows,
)
