"""The inflation valve has play of full width w: what it does stays within w/2 of what it is told, and moves
only when it must. A command of 0 shuts it and resets the play.
"""

from __future__ import annotations

import numpy as np

from flying_vines.identification.cause import Cause, Parameter, Values
from flying_vines.identification.commands import Commands, Steps


def commands(commands: Commands, x: Values) -> Commands:
    half = 0.5 * x[0]
    does = 0.0
    opening = []
    for told in commands.evp.value.tolist():
        does = max(told - half, min(told + half, does)) if told > 0.0 else 0.0
        opening.append(does)
    return commands._replace(evp=Steps(commands.evp.time_s, np.array(opening)))


CAUSE = Cause(
    name="evp_hysteresis",
    what="The inflation valve has hysteresis: it opens less on the way up than on the way down.",
    parameters=(
        Parameter(
            "width",
            low=0.0,
            high=0.6,
            seeds=(0.003, 0.05, 0.15),
            neutral=0.0,
            source="makers state about 0.1; a worn valve more",
        ),
    ),
    experiment="Raise the opening of the inflation valve in small steps and lower it again the same way.",
    commands=commands,
    order=1,
)
