"""The control volume's sensor reads gain times what it should."""

from __future__ import annotations

from flying_vines.identification.cause import Cause, Parameter, Readings, Values


def readings(readings: Readings, x: Values) -> Readings:
    return readings._replace(cv_kPa=readings.cv_kPa * x[0])


CAUSE = Cause(
    name="cv_sensor_gain",
    what="The control volume's sensor has a wrong scale.",
    parameters=(
        Parameter(
            "gain",
            low=0.5,
            high=2.0,
            seeds=(1.0,),
            neutral=1.0,
            logarithmic=True,
            source="a wrong supply or divider: some 10 %",
        ),
    ),
    experiment="Hold a pressure that a gauge of known accuracy shows as well.",
    readings=readings,
    order=1,
)
