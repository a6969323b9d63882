"""Gas in the control volume warms as it is compressed, and cools again at the wall:

dP/dt = γ α (Q_in − θ Q_out)/V − (P_a/θ)(θ − 1)/τ      air enters at ambient temperature
"""

from __future__ import annotations

from flying_vines.identification.cause import Cause, Parameter, Values
from flying_vines.identification.model import Numbers


def numbers(numbers: Numbers, x: Values) -> Numbers:
    return numbers._replace(cv_time_constant_s=x[0])


CAUSE = Cause(
    name="cv_heating",
    what="Gas in the control volume warms as it is compressed, and cools again at the wall.",
    parameters=(
        Parameter(
            "time_constant_s",
            low=1e-3,
            high=3000.0,
            seeds=(0.005, 0.05, 1.0, 30.0),
            neutral=0.0,
            logarithmic=True,
            source="volumes of 0.1 to 1 L with natural convection: 0.3 to 10 s",
        ),
    ),
    experiment=(
        "Inflate the control volume as fast as it goes, shut all valves, and record for half a minute: "
        "warm gas lets the pressure fall to a new level."
    ),
    numbers=numbers,
)
