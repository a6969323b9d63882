"""Random rigs and random flying for the proof of the physics checks: those of the cycles that are left, and
beyond. Vines of 0.05 to 1 L that are believed to be up to twice as small or large, bottles of 100 to 690 kPa,
and holds that last."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator
from dataclasses import dataclass, replace

import msgspec
from cycles_left_rigs import HOST_TICK_S, Case, Manoeuvre, draw

from firmware_link.protocol import Fault, Mode, Telemetry
from flying_vines.config import Pneumatics
from flying_vines.fakes.closed_loop import Setpoint, closed_loop
from flying_vines.pneumatics.plant.plant import Plant, at_rest
from flying_vines.pneumatics.plant.shape import Compliant, Pouch
from flying_vines.pneumatics.plant.wall import Wall
from flying_vines.pneumatics.rig import ControlVolume, Rig

RESERVE_KPA = 40.0
"""As in the default profile: below it nothing is flown."""


@dataclass(frozen=True)
class Flown:
    """A rig, and what is believed of it."""

    case: Case
    believed: Pneumatics
    cv_L: float


def drawn(seed: int) -> Flown:
    """One rig with its flying; the same seed gives the same."""
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
    return Flown(replace(case, plant=plant, program=tuple(program), fill_kPa=fill_kPa), believed, cv_L)


def telemetry_of(flown: Flown, seconds: float) -> Iterator[Telemetry]:
    """What the firmware tells while the program is flown again and again, down to the bottle's reserve."""
    case = flown.case
    table = closed_loop(
        case.plant,
        _setpoints(case, seconds),
        seconds,
        at_rest(case.plant, case.fill_kPa),
        settings=case.regulator,
        cv_sensor=case.cv_sensor,
        reservoir_sensor=case.reservoir_sensor,
        seed=case.seed,
    ).table
    names = ("time_s", "setpoint_kPa", "cv_reading_kPa", "reservoir_reading_kPa", "evp", "dvp", "solenoid")
    for t, setpoint, cv, reservoir, evp, dvp, solenoid in zip(
        *(table[n].tolist() for n in names), strict=True
    ):
        if reservoir < RESERVE_KPA:
            return
        vents = math.isnan(setpoint)
        yield Telemetry(
            round(1000 * t),
            Mode.VENT if vents else Mode.REGULATE,
            Fault.NONE,
            0,
            0.0 if vents else setpoint,
            cv,
            reservoir,
            evp,
            dvp,
            solenoid > 0.5,
        )


def _setpoints(case: Case, seconds: float) -> list[Setpoint]:
    """What the host sends every 20 ms; between two manoeuvres it may vent."""
    setpoints: list[Setpoint] = []
    tick, last, which = round(case.waits_s / HOST_TICK_S), math.floor(seconds / HOST_TICK_S), 0
    while tick < last:
        manoeuvre = case.program[which % len(case.program)]
        which += 1
        ticks = round(manoeuvre.length_s / HOST_TICK_S)
        rate = manoeuvre.steepest_kPa_per_s
        setpoints.extend(
            Setpoint((tick + i) * HOST_TICK_S, manoeuvre.setpoint_kPa((i + 1) * HOST_TICK_S), rate)
            for i in range(min(ticks, last - tick))
        )
        tick += ticks
        if manoeuvre.rest_s > 1.0 and tick < last:
            setpoints.append(Setpoint((tick - round(0.8 / HOST_TICK_S)) * HOST_TICK_S, math.nan, rate))
            setpoints = _in_order(setpoints)
    return setpoints


def _in_order(setpoints: list[Setpoint]) -> list[Setpoint]:
    vent = setpoints[-1]
    return [s for s in setpoints[:-1] if s.from_s < vent.from_s - 1e-9] + [vent]
