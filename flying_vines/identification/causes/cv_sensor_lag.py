"""The control volume's sensor follows the pressure with a first-order lag."""

from __future__ import annotations

from flying_vines.identification.cause import Cause, Parameter, Values
from flying_vines.identification.model import Numbers


def numbers(numbers: Numbers, x: Values) -> Numbers:
    return numbers._replace(cv_sensor_lag_s=x[0])


CAUSE = Cause(
    name="cv_sensor_lag",
    what="The control volume's sensor follows slowly.",
    parameters=(
        Parameter(
            "time_constant_s",
            low=1e-4,
            high=2.0,
            seeds=(0.003, 0.05),
            neutral=0.0,
            logarithmic=True,
            source="the sensor itself 1 ms; a filter or a thin hose up to a second",
        ),
    ),
    experiment="Inflate quickly, shut all valves at once, and record every millisecond.",
    numbers=numbers,
)
