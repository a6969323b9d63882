"""What else could make a discharge fast at first and slow later: causes that only this bench can have.

They are no part of the catalogue, which knows a rig with a vine; here they have to lose, or to be named.
`RESERVOIR_WALL` is the catalogue's cooling with another law of heat: a fixed hA.
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
"""Time constants after which a valve has settled."""
_STAIRS = 40


def sensor_line(flows: Callable[[int], BoolArray]) -> Cause:
    """The sensor sits where air flows.

    Args:
        flows: whether it does at each of so many readings.
    """

    def readings(readings: ModelReadings, x: Values) -> ModelReadings:
        less = x[0] * flows(len(readings.reservoir_kPa))
        return readings._replace(reservoir_kPa=readings.reservoir_kPa * (1.0 - less))

    return Cause(
        name="sensor_line",
        what="The sensor sits where air flows, and reads a share less as long as it does.",
        parameters=(
            Parameter(
                "share",
                low=0.0,
                high=0.3,
                seeds=(0.01,),
                neutral=0.0,
                typical=(0.0, 0.03),
                source="a metre of 4 mm tube takes 2 kPa at 20 SLPM, a fitting more: some 1 %",
            ),
        ),
        experiment="Shut the valve during a discharge: the reading jumps back at once.",
        readings=readings,
    )


SENSOR_LINE = sensor_line(lambda count: np.arange(count) > 0)
"""In a discharge: the first reading is taken before the valve opens."""


def _settling(commands: Commands, x: Values) -> Commands:
    """As told, but for what it passes more, in stairs, since the run began."""
    share, time_constant_s = x
    told = commands.evp
    after_s = np.linspace(0.0, SETTLED * time_constant_s, _STAIRS, endpoint=False)
    time_s = np.union1d(told.time_s, told.time_s[0] + after_s)
    opening = told.value[np.searchsorted(told.time_s, time_s, side="right") - 1]
    middle_s = time_s - told.time_s[0] + 0.5 * after_s[1]
    return commands._replace(evp=Steps(time_s, opening * (1.0 + share * np.exp(-middle_s / time_constant_s))))


VALVE_SETTLES = Cause(
    name="valve_settles",
    what="The valve passes more at first, and settles: its coil warms, its seat creeps.",
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
    experiment="Shut the valve during a discharge, wait, and open it again: it passes more again.",
    commands=_settling,
)


def _wall(base: Setup, conductance_W_per_K: float) -> Setup:
    return base.with_effects(reservoir_wall=replace(PET_BOTTLE_2L, conductance_W_per_K=conductance_W_per_K))


RESERVOIR_WALL = Cause(
    name="reservoir_wall",
    what="Gas in the reservoir cools as it expands; a fixed hA warms it, from a wall that cools as well.",
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
