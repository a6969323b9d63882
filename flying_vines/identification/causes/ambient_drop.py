"""Ambient pressure falls at a constant rate during the run: both gauge readings rise by as much."""

from __future__ import annotations

from flying_vines.identification.cause import Cause, Parameter, Values
from flying_vines.identification.model import Array


def ambient(time_s: Array, ambient_kPa: Array, x: Values) -> Array:
    fallen: Array = ambient_kPa - x[0] * (time_s - time_s[0])
    return fallen


CAUSE = Cause(
    name="ambient_drop",
    what="Ambient pressure changes during the run, as in a climb.",
    parameters=(
        Parameter(
            "rate_kPa_per_s",
            low=-1.0,
            high=2.0,
            seeds=(0.0,),
            neutral=0.0,
            source="0.012 kPa per metre: a quick drone climbs 0.2 kPa/s",
        ),
    ),
    experiment="Record the ambient pressure as well; or repeat the run on the ground.",
    ambient=ambient,
)
