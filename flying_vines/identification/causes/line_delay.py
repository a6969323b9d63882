"""The inflation valve does what it is told a while later."""

from __future__ import annotations

import numpy as np

from flying_vines.identification.cause import Cause, Parameter, Values
from flying_vines.identification.commands import Commands, Steps


def commands(commands: Commands, x: Values) -> Commands:
    evp = commands.evp
    if x[0] <= 0.0:
        return commands
    # From rest: until the first command arrives the valve is shut.
    time_s = np.concatenate((evp.time_s[:1], evp.time_s + x[0]))
    return commands._replace(evp=Steps(time_s, np.concatenate(([0.0], evp.value))))


CAUSE = Cause(
    name="line_delay",
    what="The inflation valve acts after a pure delay.",
    parameters=(
        Parameter(
            "delay_s",
            low=0.0,
            high=1.0,
            seeds=(0.001, 0.02, 0.08),
            neutral=0.0,
            source="valve 2 to 5 ms, drivers and buses up to some 100 ms",
        ),
    ),
    experiment="Open and shut the inflation valve in pulses of 0.05 to 0.5 s.",
    commands=commands,
)
