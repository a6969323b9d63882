"""A run on the believed rig, without noise: what its valves would be told, sample by sample.

Openings are what the scenario says. For pressures there is the firmware's own regulator, at 1 kHz, on the
baseline; as in `simulate`, the valves take its word once a sample. Compiled: a minute in some milliseconds.
"""

from __future__ import annotations

import random

import numpy as np

from flying_vines.identification.model import Array, Numbers, State, Told, step
from flying_vines.identification.recording import Run
from flying_vines.identification.simulate import numbers_of
from flying_vines.physics.baseline import ALPHA_KPA
from flying_vines.physics.compiler import compiled
from flying_vines.physics.rig import Rig
from flying_vines.simulation.phlosar.closed_loop import regulator_step
from flying_vines.simulation.phlosar.regulator import Regulator
from flying_vines.simulation.scenario.command import command_of, valves_of
from flying_vines.simulation.scenario.kinds import FIRMWARE_HZ, Kind
from flying_vines.simulation.scenario.regulation import FASTEST_KPA_PER_S, tuning_for
from flying_vines.simulation.scenario.run import OPENING_DIGITS


def rehearsed(rig: Rig, kind: Kind) -> Run:
    """The run as it would be recorded, without readings."""
    samples = max(1, round(kind.length_s * kind.sample_rate_Hz))
    time_s = np.arange(samples) / kind.sample_rate_Hz
    valves = valves_of(kind, random.Random(0))
    if valves is not None:
        # They ask for a pressure only to end early, which on the believed rig they do not.
        openings = np.array([valves(t, 0.0) for t in time_s.tolist()], dtype=np.float64)
    else:
        openings = _regulated(rig, kind, time_s)
    evp, dvp, solenoid = openings.T
    unread = np.zeros_like(time_s)
    cv_kPa = np.full_like(time_s, np.nan) if rig.cv is None else unread
    return Run(kind.label, time_s, None, evp, dvp, solenoid, cv_kPa, unread, None, None, rig.cv is None)


def _regulated(rig: Rig, kind: Kind, time_s: Array) -> Array:
    command = command_of(kind, random.Random(0))
    assert command is not None and rig.cv is not None, "a run either regulates or moves the valves"
    regulator = Regulator(tuning_for(rig, rig.cv, kind.reservoir_kPa, kind.sample_rate_Hz))
    openings = np.empty((len(time_s), 3))
    compiled(regulate_held, (step,))(
        numbers_of(rig),
        regulator.address,
        np.array([command(t) for t in time_s.tolist()]),
        kind.reservoir_kPa,
        FIRMWARE_HZ // kind.sample_rate_Hz,
        openings,
    )
    return openings


def regulate_held(
    numbers: Numbers,
    regulator: int,
    wanted_kPa: Array,
    reservoir_kPa: float,
    ticks: int,
    openings: Array,
) -> None:
    """Fill `openings` (n, 3): from each sample on, for so many ticks, what the valves are told."""
    nothing = np.zeros(0)
    state = State(reservoir_kPa, 1.0, 0.0, 1.0)
    drive = np.empty(4)
    for sample in range(len(wanted_kPa)):
        evp = dvp = solenoid = 0.0
        for tick in range(ticks):
            target_kPa = wanted_kPa[sample]
            regulator_step(
                regulator, target_kPa, FASTEST_KPA_PER_S, state.cv_kPa, state.reservoir_kPa, drive.ctypes
            )
            if tick == 0:
                evp, dvp = round(drive[0], OPENING_DIGITS), round(drive[1], OPENING_DIGITS)
                solenoid = drive[2]
                openings[sample] = evp, dvp, solenoid
            told = Told(0.0, evp, dvp, solenoid, ALPHA_KPA, 0.0, evp)
            state = step(numbers, told, state, 1.0 / FIRMWARE_HZ, nothing)
