"""Simulates a planned run on the nominal rig, without noise, to get its valve commands sample by sample.

Runs of openings give the commands directly. In runs of pressures the firmware's regulator controls the
baseline at 1 kHz. As in `simulate`, the valves get a new command once a sample. The loop is compiled: a run
of a minute takes milliseconds.
"""

from __future__ import annotations

import random

import numpy as np

from flying_vines.identification.recording import RecordedRun
from flying_vines.physics.arrays import Array
from flying_vines.physics.compiler import compiled, record
from flying_vines.physics.constants import ALPHA_KPA
from flying_vines.physics.plant.ambient import Air
from flying_vines.physics.plant.compiled import floats_of
from flying_vines.physics.plant.loops import NOT_INLINED
from flying_vines.physics.plant.numbers import PlantNumbers, numbers_of
from flying_vines.physics.plant.plant import Held, Plant, at_rest
from flying_vines.physics.plant.rates import Floats, conditions
from flying_vines.physics.plant.tick import runge_kutta
from flying_vines.physics.rig import Rig
from flying_vines.simulation.phlosar.closed_loop import regulator_step
from flying_vines.simulation.phlosar.firmware import Regulator
from flying_vines.simulation.scenario.run import (
    FASTEST_KPA_PER_S,
    OPENING_DIGITS,
    command_of,
    tuning_for,
    valves_of,
)
from flying_vines.simulation.scenario.scenario import FIRMWARE_HZ, RunKind


def nominal_run(rig: Rig, kind: RunKind) -> RecordedRun:
    """The run as a recording; its readings are only placeholders: 0, or NaN without a control volume."""
    samples = max(1, round(kind.length_s * kind.sample_rate_Hz))
    time_s = np.arange(samples) / kind.sample_rate_Hz
    valves = valves_of(kind, random.Random(0))
    if valves is not None:
        # The pressure only matters for closing a valve early, which does not happen on the nominal rig.
        openings = np.array([valves(t, 0.0) for t in time_s.tolist()], dtype=np.float64)
    else:
        openings = _regulated(rig, kind, time_s)
    evp, dvp, solenoid = openings.T
    unread = np.zeros_like(time_s)
    cv_kPa = np.full_like(time_s, np.nan) if rig.cv is None else unread
    return RecordedRun(
        kind.label, time_s, None, evp, dvp, solenoid, cv_kPa, unread, None, None, rig.cv is None
    )


def _regulated(rig: Rig, kind: RunKind, time_s: Array) -> Array:
    command = command_of(kind, random.Random(0))
    assert command is not None and rig.cv is not None, "a run either regulates or moves the valves"
    regulator = Regulator(tuning_for(rig, rig.cv, kind.reservoir_kPa, kind.sample_rate_Hz))
    openings = np.empty((len(time_s), 3))
    plant = Plant(rig)
    compiled(regulate_held, NOT_INLINED)(
        record(numbers_of(plant, 1.0 / FIRMWARE_HZ)),
        floats_of(at_rest(plant, kind.reservoir_kPa)),
        regulator.address,
        np.array([command(t) for t in time_s.tolist()]),
        FIRMWARE_HZ // kind.sample_rate_Hz,
        openings,
    )
    return openings


def regulate_held(
    numbers: PlantNumbers,
    state: Floats,
    regulator: int,
    wanted_kPa: Array,
    ticks: int,
    openings: Array,
) -> None:
    """Fill `openings` (n, 3): the valve commands of each sample, which hold for `ticks` ticks."""
    air = Air(ALPHA_KPA, 0.0, 1.0, 0.0)
    drive = np.empty(4)
    for sample in range(len(wanted_kPa)):
        evp = dvp = solenoid = 0.0
        for tick in range(ticks):
            found = conditions(numbers, air, state)
            target_kPa = wanted_kPa[sample]
            regulator_step(
                regulator, target_kPa, FASTEST_KPA_PER_S, found.cv_kPa, found.reservoir_kPa, drive.ctypes
            )
            if tick == 0:
                evp, dvp = round(drive[0], OPENING_DIGITS), round(drive[1], OPENING_DIGITS)
                solenoid = drive[2]
                openings[sample] = evp, dvp, solenoid
            held = Held(evp, dvp, solenoid > 0.0, False)
            state = runge_kutta(numbers, air, 0.0, state, held, 1.0 / FIRMWARE_HZ)
