"""The inflation valve opens only beyond u₀: max(0, (u − u₀)/(1 − u₀)); a full command opens it fully."""

from __future__ import annotations

import numpy as np

from flying_vines.identification.cause import Cause, Parameter, Values
from flying_vines.identification.commands import Commands, Steps


def commands(commands: Commands, x: Values) -> Commands:
    evp = commands.evp
    opening = np.maximum(0.0, (evp.value - x[0]) / (1.0 - x[0]))
    return commands._replace(evp=Steps(evp.time_s, opening))


CAUSE = Cause(
    name="evp_dead_zone",
    what="The inflation valve stays shut until its command has passed a dead zone.",
    parameters=(
        Parameter(
            "opening",
            low=0.0,
            high=0.9,
            seeds=(0.002, 0.05, 0.2),
            neutral=0.0,
            source="small proportional valves: 0.25 to 0.45 of full current",
        ),
    ),
    experiment="Raise the opening of the inflation valve from 0 to 1 in small steps, a second each.",
    commands=commands,
    order=2,
)
