"""Below a supply pressure the Venturi makes no vacuum."""

from __future__ import annotations

from flying_vines.identification.cause import Cause, Parameter, Values
from flying_vines.identification.model import Numbers


def numbers(numbers: Numbers, x: Values) -> Numbers:
    return numbers._replace(stall_supply_kPa=x[0])


CAUSE = Cause(
    name="venturi_stall",
    what="The Venturi stalls below a supply pressure.",
    parameters=(
        Parameter(
            "supply_pressure_kPa",
            low=10.0,
            high=900.0,
            seeds=tuple(range(60, 700, 20)),
            neutral=0.0,
            source="ejectors: falling below about 300 kPa",
        ),
    ),
    experiment="Empty the control volume with the Venturi again and again until the reservoir is empty.",
    numbers=numbers,
)
