"""The inflation valve, or what leads to it, resists scale times as much as believed."""

from __future__ import annotations

from flying_vines.identification.cause import Cause, Parameter, Values
from flying_vines.identification.model import Numbers


def numbers(numbers: Numbers, x: Values) -> Numbers:
    return numbers._replace(evp_flow_resistance_kPa_s_per_SL=numbers.evp_flow_resistance_kPa_s_per_SL * x[0])


CAUSE = Cause(
    name="evp_restriction",
    what="The inflation valve passes more or less than believed.",
    parameters=(
        Parameter(
            "scale",
            low=0.1,
            high=20.0,
            seeds=(1.0,),
            neutral=1.0,
            logarithmic=True,
            source="from a valve without its orifice to one that is nearly clogged",
        ),
    ),
    experiment="Open the inflation valve fully into a known volume from the full reservoir.",
    numbers=numbers,
)
