"""Other causes of a discharge that is fast at first and slow later, which only this bench can have.

They are not in the catalogue, because they assume a valve that is open from the first reading to the last.
"""

from __future__ import annotations

import numpy as np

from flying_vines.physics.cause import Cause, ModelReadings, Parameter, Values
from flying_vines.physics.plant.commands import Commands, Steps

SETTLED = 5.0
"""Number of time constants after which a valve has settled."""
_STAIRS = 40


def _less_in_the_flow(readings: ModelReadings, x: Values) -> ModelReadings:
    # The first reading was taken before the valve opened.
    flows = np.arange(len(readings.reservoir_kPa)) > 0
    return readings._replace(reservoir_kPa=readings.reservoir_kPa * (1.0 - x[0] * flows))


SENSOR_LINE = Cause(
    name="sensor_line",
    what="The sensor is in the flow, and its reading is lower by a share while air flows.",
    parameters=(
        Parameter(
            "share",
            low=0.0,
            high=0.06,
            seeds=(0.01,),
            neutral=0.0,
            source="a metre of 4 mm tube loses 2 kPa at 20 SLPM, a fitting more: 1 %, at most 6 %",
        ),
    ),
    experiment="Shut the valve during a discharge: the reading jumps back immediately.",
    readings=_less_in_the_flow,
)


def _settling(commands: Commands, x: Values) -> Commands:
    """The commands with an additional opening that decays from the start on, in steps."""
    share, time_constant_s = x
    evp = commands.evp
    stairs_s = np.linspace(0.0, SETTLED * time_constant_s, _STAIRS + 1)
    time_s = np.union1d(evp.time_s, evp.time_s[0] + stairs_s)
    opening = evp.value[np.searchsorted(evp.time_s, time_s, side="right") - 1]
    since_s = time_s - evp.time_s[0]
    more = share * np.exp(-(since_s + 0.5 * stairs_s[1]) / time_constant_s)
    return commands._replace(evp=Steps(time_s, opening * (1.0 + more * (since_s < stairs_s[-1]))))


VALVE_SETTLES = Cause(
    name="valve_settles",
    what="The valve has more flow at first and settles: its coil warms, its seat creeps.",
    parameters=(
        Parameter(
            "share",
            low=0.0,
            high=0.5,
            seeds=(0.1, 0.3),
            neutral=0.0,
            source="a coil on a fixed voltage loses 10 to 20 % of its current, so up to 40 % of its flow",
        ),
        Parameter(
            "time_constant_s",
            low=1.0,
            high=300.0,
            seeds=(10.0,),
            neutral=None,
            logarithmic=True,
            source="seats and coils: seconds to minutes",
        ),
    ),
    experiment="Shut the valve during a discharge, wait, and open it again: the flow is larger again.",
    commands=_settling,
)
