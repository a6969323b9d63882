"""The control volume stretches: V = V₀ (1 + k P) for P > 0, its air conserved."""

from __future__ import annotations

from flying_vines.identification.cause import Cause, Parameter, Values
from flying_vines.identification.model import Numbers


def numbers(numbers: Numbers, x: Values) -> Numbers:
    return numbers._replace(cv_compliance_per_kPa=x[0])


CAUSE = Cause(
    name="cv_compliance",
    what="The control volume grows with its pressure.",
    parameters=(
        Parameter(
            "per_kPa",
            low=1e-7,
            high=0.5,
            seeds=(1e-5, 1e-3, 1e-2),
            neutral=0.0,
            logarithmic=True,
            source="from a bottle to a balloon that doubles in 2 kPa",
        ),
    ),
    experiment="Inflate in several steps to the highest pressure, each with the same opening and duration.",
    numbers=numbers,
)
