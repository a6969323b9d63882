"""The solenoid stays open for a while after it is told to close."""

from __future__ import annotations

import numpy as np

from flying_vines.identification.cause import Cause, Parameter, Values
from flying_vines.identification.commands import Commands, Steps


def commands(commands: Commands, x: Values) -> Commands:
    solenoid = commands.solenoid
    if x[0] <= 0.0:
        return commands
    opens = solenoid.value > 0.0
    closing = ~opens & np.concatenate(([False], opens[:-1]))
    time_s = np.where(closing, solenoid.time_s + x[0], solenoid.time_s)
    # Told to open again before it has closed, it stays open.
    again = np.concatenate((time_s[1:], [np.inf]))
    kept = ~(closing & (time_s >= again))
    return commands._replace(solenoid=Steps(time_s[kept], solenoid.value[kept]))


CAUSE = Cause(
    name="solenoid_slow_close",
    what="The solenoid closes late.",
    parameters=(
        Parameter(
            "delay_s",
            low=0.0,
            high=1.0,
            seeds=(0.001, 0.02, 0.08),
            neutral=0.0,
            source="10 to 40 ms with a fly-back diode; sticky ones more",
        ),
    ),
    experiment="Vent the inflated control volume in pulses of 0.05 to 0.5 s.",
    commands=commands,
)
