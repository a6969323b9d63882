"""Other causes of a discharge that is fast at first and slow later, which only this bench can have.

They are not in the catalogue, which is for a rig with a vine. `RESERVOIR_WALL` is the catalogue's reservoir
cooling with another law of heat: a fixed hA.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import log

import numpy as np

from flying_vines.physics.arrays import BoolArray
from flying_vines.physics.cause import Cause, ModelReadings, Parameter, Values
from flying_vines.physics.plant.commands import Commands, Steps
from flying_vines.physics.plant.setup import Setup
from flying_vines.physics.plant.wall import PET_BOTTLE_2L

SETTLED = 5.0
"""Number of time constants after which a valve has settled."""
_STAIRS = 40


def sensor_line(flows: Callable[[int], BoolArray]) -> Cause:
    """The sensor is in the flow; `flows(n)` gives for each of n readings if air flows."""

    def readings(readings: ModelReadings, x: Values) -> ModelReadings:
        less = x[0] * flows(len(readings.reservoir_kPa))
        return readings._replace(reservoir_kPa=readings.reservoir_kPa * (1.0 - less))

    return Cause(
        name="sensor_line",
        what="The sensor is in the flow, and reads a share less while air flows.",
        parameters=(
            Parameter(
                "share",
                low=0.0,
                high=0.3,
                seeds=(0.01,),
                neutral=0.0,
                typical=(0.0, 0.03),
                source="a metre of 4 mm tube loses 2 kPa at 20 SLPM, a fitting more: about 1 %",
            ),
        ),
        experiment="Shut the valve during a discharge: the reading jumps back immediately.",
        readings=readings,
    )


SENSOR_LINE = sensor_line(lambda count: np.arange(count) > 0)
"""For a discharge, whose first reading is taken before the valve opens."""


def _settling(commands: Commands, x: Values) -> Commands:
    """The commands with the additional opening since the start, in steps."""
    share, time_constant_s = x
    evp = commands.evp
    after_s = np.linspace(0.0, SETTLED * time_constant_s, _STAIRS, endpoint=False)
    time_s = np.union1d(evp.time_s, evp.time_s[0] + after_s)
    opening = evp.value[np.searchsorted(evp.time_s, time_s, side="right") - 1]
    middle_s = time_s - evp.time_s[0] + 0.5 * after_s[1]
    return commands._replace(evp=Steps(time_s, opening * (1.0 + share * np.exp(-middle_s / time_constant_s))))


VALVE_SETTLES = Cause(
    name="valve_settles",
    what="The valve has more flow at first and settles: its coil warms, its seat creeps.",
    parameters=(
        Parameter(
            "share",
            low=-0.5,
            high=2.0,
            seeds=(0.3,),
            neutral=0.0,
            typical=(0.0, 0.2),
            source="a coil on a fixed voltage loses 10 to 20 % of its current as it warms",
        ),
        Parameter(
            "time_constant_s",
            low=1.0,
            high=300.0,
            seeds=(10.0,),
            neutral=None,
            logarithmic=True,
            typical=(log(10.0), 1.0),
            source="seats and coils: seconds to minutes",
        ),
    ),
    experiment="Shut the valve during a discharge, wait, and open it again: the flow is larger again.",
    commands=_settling,
)


def _wall(base: Setup, conductance_W_per_K: float) -> Setup:
    return base.with_effects(reservoir_wall=replace(PET_BOTTLE_2L, conductance_W_per_K=conductance_W_per_K))


RESERVOIR_WALL = Cause(
    name="reservoir_wall",
    what="Gas in the reservoir cools as it expands; a wall, which also cools, warms it through a fixed hA.",
    parameters=(
        Parameter(
            "conductance_W_per_K",
            low=0.05,
            high=20.0,
            seeds=(1.0,),
            neutral=float("inf"),
            logarithmic=True,
            typical=(0.0, 0.6),
            source="natural convection in a 2 L bottle: 0.6 W/K at 2 bar to 1.4 at 8",
        ),
    ),
    experiment="As reservoir_cooling.",
    apply=_wall,
)
