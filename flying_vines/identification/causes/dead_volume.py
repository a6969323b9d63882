"""The control volume is larger than believed: tubing, fittings, the sensor's port."""

from __future__ import annotations

from flying_vines.identification.cause import Cause, Parameter, Values
from flying_vines.identification.model import Numbers


def numbers(numbers: Numbers, x: Values) -> Numbers:
    return numbers._replace(cv_volume_L=numbers.cv_volume_L + x[0])


CAUSE = Cause(
    name="dead_volume",
    what="The control volume is larger than believed.",
    parameters=(
        Parameter(
            "volume_L",
            low=1e-5,
            high=5.0,
            seeds=(0.003, 0.03),
            neutral=0.0,
            logarithmic=True,
            source="from a fitting to a vessel of the wrong size",
        ),
    ),
    experiment="Weigh the control volume and its tubing full of water; or inflate it through a known flow.",
    numbers=numbers,
)
