"""Random rigs and programs for the benchmark of the physics checks. They extend those of the cycles left:
vines of 0.05 to 1 L whose assumed volume is half to twice the true one, reservoirs of 100 to 690 kPa, and
long holds.
"""

from __future__ import annotations

import math
import random
from collections.abc import Iterator
from dataclasses import replace

import msgspec
from cycles_left_flights import setpoints_of, telemetry_messages
from cycles_left_rigs import HOST_TICK_S, Case, Manoeuvre, draw

from firmware_link.protocol import Telemetry
from flying_vines.config.config import InterlocksConfig
from flying_vines.physics.plant.plant import Plant, at_rest
from flying_vines.physics.plant.volume import Compliant, Pouch
from flying_vines.physics.plant.wall import Wall
from flying_vines.physics.rig import ControlVolume, Rig
from flying_vines.simulation.phlosar.closed_loop import SetpointChange, closed_loop

RESERVE_KPA = InterlocksConfig().reserve_kPa
"""Below this reservoir pressure nothing is flown."""
LONG_REST_S = 1.0
"""If the rest of a manoeuvre is longer than this, the host vents at the end of the rest."""
VENTED_TICKS = round(0.8 / HOST_TICK_S)
"""The host vents for this number of its ticks."""


def drawn(seed: int) -> Case:
    """One rig with its program; the same seed gives the same rig."""
    dice = random.Random(f"physics checks {seed}")
    case = draw(seed)
    cv_L = math.exp(dice.uniform(math.log(0.05), math.log(1.0)))
    factor = math.exp(dice.uniform(math.log(0.5), math.log(2.0)))
    fill_kPa = dice.uniform(100.0, 690.0)
    old_rig, effects = case.plant.rig, case.plant.effects
    assert old_rig.cv is not None
    shape = effects.cv_shape
    if isinstance(shape, Pouch):
        shape = Pouch(shape.flat_volume_L * cv_L / old_rig.cv.volume_L, shape.per_kPa)
    else:
        assert shape is None or isinstance(shape, Compliant)
    wall = Wall(
        conductance_W_per_K=0.3 * (cv_L / 0.1) ** (2.0 / 3.0) * dice.uniform(0.5, 2.0),
        capacity_J_per_K=200.0 * cv_L,
        outer_conductance_W_per_K=5.0 * cv_L,
    )
    plant = Plant(Rig(old_rig.reservoir, ControlVolume(cv_L)), replace(effects, cv_shape=shape, cv_wall=wall))
    program = list(case.program)
    if dice.random() < 0.5:
        top_kPa = dice.uniform(5.0, 24.0)
        rate, hold_s, rest_s = dice.uniform(15.0, 60.0), dice.uniform(8.0, 25.0), dice.uniform(0.5, 9.0)
        long = Manoeuvre(0.0, top_kPa, rate, hold_s, rest_s)
        program.insert(dice.randrange(len(program) + 1), long)
    believed = msgspec.structs.replace(case.believed, cv_volume_L=cv_L / factor)
    return replace(case, believed=believed, plant=plant, program=tuple(program), fill_kPa=fill_kPa)


def telemetry_of(case: Case, seconds: float) -> Iterator[Telemetry]:
    """The firmware's telemetry while the program is repeated, down to the reserve pressure."""
    table = closed_loop(
        case.plant,
        _setpoints(case, seconds),
        seconds,
        at_rest(case.plant, case.fill_kPa),
        tuning=case.tuning,
        cv_sensor=case.cv_sensor,
        reservoir_sensor=case.reservoir_sensor,
        seed=case.seed,
    ).table
    for _, telemetry in telemetry_messages(table):
        if telemetry.reservoir_kPa < RESERVE_KPA:
            return
        yield telemetry


def _setpoints(case: Case, seconds: float) -> list[SetpointChange]:
    """As for the cycles left, but the host vents at the end of each long rest."""
    begins_s, setpoints = setpoints_of(case, seconds)
    first_tick = round(begins_s[0] / HOST_TICK_S)
    for index, end_s in enumerate(begins_s[1:]):
        if case.program[index % len(case.program)].rest_s > LONG_REST_S:
            end = round(end_s / HOST_TICK_S) - first_tick
            for at in range(end - VENTED_TICKS, end):
                setpoints[at] = setpoints[at]._replace(target_kPa=math.nan)
    return setpoints
