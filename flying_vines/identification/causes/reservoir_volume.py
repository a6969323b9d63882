"""The reservoir holds scale times what is believed."""

from __future__ import annotations

from flying_vines.identification.cause import Cause, Parameter, Values
from flying_vines.identification.model import Numbers


def numbers(numbers: Numbers, x: Values) -> Numbers:
    return numbers._replace(reservoir_volume_L=numbers.reservoir_volume_L * x[0])


CAUSE = Cause(
    name="reservoir_volume",
    what="The reservoir is larger or smaller than believed.",
    parameters=(
        Parameter(
            "scale",
            low=0.2,
            high=5.0,
            seeds=(1.0,),
            neutral=1.0,
            logarithmic=True,
            source="from the next smaller bottle to the next larger",
        ),
    ),
    experiment="Weigh the reservoir full of water; or discharge it through a known flow.",
    numbers=numbers,
)
