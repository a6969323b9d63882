"""Flies the program of a rig again and again, until the reservoir is too low for it.

A manoeuvre succeeds if the reading of the control volume is near the manoeuvre's top pressure while the
setpoint is near it too. The tolerance of both (`tolerance_kPa`) is 1.5 kPa, or a tenth of the swing if that
is more. The flight ends when one manoeuvre of the program fails in three rounds in a row, and it counts up to
the first of these failures. Fewer failures in a row may be due to the regulator.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from cycles_left_rigs import HOST_TICK_S, Case, Manoeuvre
from numpy.typing import NDArray

from firmware_link.protocol import Fault, Mode, Telemetry
from flying_vines.physics.plant.plant import at_rest
from flying_vines.simulation.phlosar.closed_loop import SetpointChange, closed_loop
from flying_vines.supply.air_use import tolerance_kPa

Array = NDArray[np.float64]

FEWEST_CYCLES = 30.0
"""A rig with fewer cycles is skipped: after the first 15 cycles, 15 must be left to predict."""
FIRST_S = 300.0
"""Length of the first simulation. It is tripled until the flight ends within it."""
LONGEST_S = 8100.0
TELEMETRY_HZ = 100
MISSES = 3
SMOOTHED = 3
"""Number of readings of the control volume that are averaged, so that no single reading decides."""


@dataclass(frozen=True, eq=False)
class Flight:
    """The firmware's telemetry, one row every 10 ms, and the start of each manoeuvre."""

    telemetry: NDArray[np.void]
    begins_s: Array
    """Start of each manoeuvre, up to the one that fails."""
    cycles: Array
    """Cycles flown before each manoeuvre. A manoeuvre with a smaller swing counts as a part of a cycle."""

    @property
    def total_cycles(self) -> float:
        return float(self.cycles[-1])


def began(flight: Flight, cycles: float) -> int:
    """The first manoeuvre that began after this many cycles."""
    return int(np.searchsorted(flight.cycles, cycles - 1e-9))


def fly(case: Case) -> Flight | None:
    """Fly from a filled reservoir at rest. None if the flight is too long."""
    length_s = FIRST_S
    while length_s <= LONGEST_S:
        flight = _fly(case, length_s)
        if flight is not None:
            return flight
        length_s *= 3.0
    return None


def _fly(case: Case, length_s: float) -> Flight | None:
    begins, setpoints = setpoints_of(case, length_s)
    run = closed_loop(
        case.plant,
        setpoints,
        length_s,
        at_rest(case.plant, case.fill_kPa),
        tuning=case.tuning,
        cv_sensor=case.cv_sensor,
        reservoir_sensor=case.reservoir_sensor,
        seed=case.seed,
        record_every=1000 // TELEMETRY_HZ,
    )
    table = run.table
    smooth = np.convolve(table["cv_reading_kPa"], np.full(SMOOTHED, 1.0 / SMOOTHED), "same")
    setpoint = np.nan_to_num(table["setpoint_kPa"])
    program = case.program
    missed = [0] * len(program)
    for index, (begin_s, end_s) in enumerate(pairwise(begins)):
        which = index % len(program)
        rows = slice(round(begin_s * TELEMETRY_HZ), round(end_s * TELEMETRY_HZ))
        missed[which] = 0 if met(program[which], setpoint[rows], smooth[rows]) else missed[which] + 1
        if missed[which] == MISSES:
            first = index - (MISSES - 1) * len(program)
            kPa = np.array([program[i % len(program)].swing_kPa for i in range(first)])
            cycles = np.concatenate([[0.0], np.cumsum(kPa)]) / case.believed.cycle_swing_kPa
            return Flight(table[: rows.stop], np.array(begins[: first + 1]), cycles)
    return None


def met(manoeuvre: Manoeuvre, setpoint_kPa: Array, cv_kPa: Array) -> bool:
    """True if the control volume reached the top in the given time."""
    least_kPa = manoeuvre.top_kPa - tolerance_kPa(manoeuvre.swing_kPa)
    return bool(np.any(cv_kPa[setpoint_kPa >= least_kPa] >= least_kPa))


def telemetry_messages(table: NDArray[np.void]) -> Iterator[tuple[float, Telemetry]]:
    """The firmware's telemetry messages, with their times."""
    venting = np.isnan(table["setpoint_kPa"])
    columns = [
        table["time_s"],
        venting,
        np.where(venting, 0.0, table["setpoint_kPa"]),
        *(table[name] for name in ("cv_reading_kPa", "reservoir_reading_kPa", "evp", "dvp")),
        table["solenoid"] > 0.5,
    ]
    rows = zip(*(column.tolist() for column in columns), strict=True)
    for t, vents, setpoint, cv, reservoir, evp, dvp, solenoid in rows:
        mode = Mode.VENT if vents else Mode.REGULATE
        yield t, Telemetry(round(1000 * t), mode, Fault.NONE, 0, setpoint, cv, reservoir, evp, dvp, solenoid)


def setpoints_of(case: Case, length_s: float) -> tuple[list[float], list[SetpointChange]]:
    """The start of each manoeuvre, and the setpoint that the host sends every 20 ms."""
    begins: list[float] = []
    setpoints: list[SetpointChange] = []
    tick, last = round(case.waits_s / HOST_TICK_S), math.floor(length_s / HOST_TICK_S)
    while tick < last:
        manoeuvre = case.program[len(begins) % len(case.program)]
        begins.append(tick * HOST_TICK_S)
        ticks = round(manoeuvre.length_s / HOST_TICK_S)
        rate_kPa_per_s = manoeuvre.steepest_kPa_per_s
        setpoints.extend(
            SetpointChange(
                (tick + i) * HOST_TICK_S, manoeuvre.setpoint_kPa((i + 1) * HOST_TICK_S), rate_kPa_per_s
            )
            for i in range(min(ticks, last - tick))
        )
        tick += ticks
    return begins, setpoints
