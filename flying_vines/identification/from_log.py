"""A flight log as a case: what the firmware told, from rest to rest.

    case = read_flight("flights/2026-05-04_10-30-00")       the flight's folder, or its flight.mcap

Telemetry says what the valves are told from its moment on. It is complete when it comes with every step of
the firmware's regulator; where it is slower, nobody knows what the valves did in between: a remark says so.
Time is the firmware's own clock, for the host's has the link's delays in it.

Readings are kept every few milliseconds and, in between, only what the valves did: a regulator acts on what
it reads, so a reading must not be chosen by what a valve did next.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from math import ceil, isfinite
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_link.protocol import Fault, Mode
from flying_vines.identification.case import Case
from flying_vines.identification.recording import CaseError, RecordedRun
from flying_vines.physics.arrays import Array
from flying_vines.physics.rig import Rig, RigError, load_rig, rig_from
from flying_vines.record.folders import MCAP
from flying_vines.record.reader import FlightLog, LogError
from flying_vines.record.topics import SNAPSHOT, START, TELEMETRY

STEP_MS = 1
"""Of the firmware's regulator: so often the valves may move."""
READING_MS = 5
"""How often readings are kept."""
PAUSE_MS = 300
"""Without telemetry for longer, nobody knows in what state the rig is: a run ends."""
LEAD_MS = 1000
"""Of rest, with which a run begins."""
TAIL_MS = 5000
"""Of rest, with which it ends: gas comes back to the temperature around."""
MOST_MS = 180_000
"""Of record are used; of more, runs from all over the flight."""
LOST = 0.01
"""A larger share of lost telemetry is worth a remark."""
_WRAP_MS = 1 << 32
AIR_KPA = (40.0, 115.0)
"""What a barometer that works reads anywhere."""
_FIELDS = ("t", "device_time_ms", "mode", "faults", "setpoint_kPa", "cv_kPa", "reservoir_kPa")
_VALVES = ("evp_opening", "dvp_opening", "solenoid")


class _Telemetry(NamedTuple):
    """A stretch of it, an element a message."""

    time_ms: NDArray[np.int64]
    """Of the firmware's clock, without its wraps."""
    regulates: NDArray[np.bool_]
    setpoint_kPa: Array
    cv_kPa: Array
    reservoir_kPa: Array
    """NaN while a latched fault names the sensor: what it says then is its last good reading."""
    valves: Array
    """(n, 3): openings of EVP and DVP, and the solenoid."""
    ambient_kPa: Array
    """Absolute; NaN where nobody measured it."""

    def part(self, which: slice | NDArray[np.bool_]) -> _Telemetry:
        return _Telemetry._make(values[which] for values in self)

    @property
    def length_ms(self) -> int:
        return int(self.time_ms[-1] - self.time_ms[0])


def is_flight(path: Path) -> bool:
    """Whether a path is a flight log, or the folder of one."""
    return path.suffix == Path(MCAP).suffix or (path / MCAP).is_file()


def read_flight(path: Path | str, rig: Path | str | None = None) -> Case:
    """The case in a flight log.

    Args:
        path: the log, or the flight's folder.
        rig: a rig file; unless given, what the log says was believed.

    Raises CaseError when it cannot be read, or nothing in it tells of a rig.
    """
    flight = FlightLog(Path(path))
    path = flight.path
    log = _read(flight)
    believed = _believed(path, log.tables, rig)
    stretches = list(_stretches(log))
    remarks = [*_said_of(path, stretches)]
    if log.unknown:
        total = len(log.telemetry) + log.unknown
        remarks.append(f"{path.name}: {log.unknown} of {total} readings are incomplete and left out")
    if flight.damage:
        remarks.append(flight.damage)
    flown = [run for stretch in stretches for run in _from_rest(stretch)]
    if not flown:
        raise CaseError(
            f"{path}: no setpoint was held after {LEAD_MS / 1000:g} s of rest; fly some bends, "
            "the first from a vented vine"
        )
    every = ceil(sum(run.length_ms for run in flown) / MOST_MS)
    if every > 1:
        remarks.append(
            f"{path.name}: {len(flown[::every])} of {len(flown)} runs are used, from all over the flight"
        )
    runs = [_run(f"flight_{number}", run) for number, run in enumerate(flown[::every], start=1)]
    return Case(path, believed, tuple(runs), tuple(remarks))


class _Log(NamedTuple):
    tables: Any
    """Of the believed rig."""
    telemetry: Array
    """(n, 10), as `_FIELDS` and `_VALVES` have it."""
    ambient: Array
    """(m, 2): time and pressure, kPa absolute."""
    unknown: int
    """Messages of telemetry with numbers that are none."""


def _read(flight: FlightLog) -> _Log:
    tables: Any = None
    rows: list[list[float]] = []
    ambient: list[list[float]] = []
    unknown = 0
    try:
        for entry in flight.entries((START, TELEMETRY, SNAPSHOT)):
            said = entry.fields
            if entry.topic == START:
                tables = said.get("believed")
            elif entry.topic == TELEMETRY:
                row = _numbers(said, (*_FIELDS, *_VALVES))
                if row is None:
                    unknown += 1
                else:
                    rows.append(row)
            elif (air := _numbers(said, ("t", "ambient_kPa"))) and AIR_KPA[0] <= air[1] <= AIR_KPA[1]:
                ambient.append(air)
    except LogError as error:
        raise CaseError(str(error)) from None
    if len(rows) < 2:
        raise CaseError(f"{flight.path}: holds no telemetry: no phloSAR answered")
    return _Log(tables, np.array(rows), np.array(ambient).reshape(-1, 2), unknown)


def _numbers(entry: Mapping[str, Any], names: Sequence[str]) -> list[float] | None:
    try:
        row = [float(entry[name]) for name in names]
    except (KeyError, TypeError, ValueError):
        return None
    return row if all(map(isfinite, row)) else None


def _believed(path: Path, tables: Any, rig: Path | str | None) -> Rig:
    try:
        if rig is not None:
            believed = load_rig(rig)
            if believed.cv is None:
                raise CaseError(f"{rig}: a flight has a control volume; add [cv] with its volume_L")
            return believed
        if not isinstance(tables, Mapping):
            raise CaseError(f"{path}: does not say what the rig is believed to be; give --rig RIG.toml")
        return rig_from({name: table for name, table in tables.items() if table is not None})
    except RigError as error:
        raise CaseError(str(error) if rig is not None else f"{path}: {error}") from None


def _stretches(log: _Log) -> Iterator[_Telemetry]:
    """What came without a pause."""
    rows = log.telemetry
    t, clock, mode, faults, setpoint_kPa, cv_kPa, reservoir_kPa = rows[:, : len(_FIELDS)].T
    step_ms = np.diff(clock.astype(np.int64))
    step_ms[step_ms < -_WRAP_MS // 2] += _WRAP_MS
    bits = faults.astype(np.int64)
    whole = _Telemetry(
        time_ms=np.concatenate(([0], np.cumsum(step_ms))),
        regulates=mode == Mode.REGULATE,
        setpoint_kPa=setpoint_kPa,
        cv_kPa=np.where(bits & Fault.CV_SENSOR, np.nan, cv_kPa),
        reservoir_kPa=np.where(bits & Fault.RESERVOIR_SENSOR, np.nan, reservoir_kPa),
        valves=rows[:, len(_FIELDS) :],
        ambient_kPa=np.interp(t, *log.ambient.T) if len(log.ambient) else np.full_like(t, np.nan),
    )
    # A clock that runs back otherwise is a firmware that started anew.
    cuts = np.flatnonzero((step_ms > PAUSE_MS) | (step_ms < 0)) + 1
    for first, last in pairwise((0, *cuts.tolist(), len(rows))):
        stretch = whole.part(slice(first, last))
        yield stretch.part(np.append(np.diff(stretch.time_ms) > 0, True))


def _said_of(path: Path, stretches: Sequence[_Telemetry]) -> Iterator[str]:
    """What of the telemetry limits a verdict."""
    steps_ms = np.concatenate([np.diff(stretch.time_ms) for stretch in stretches])
    if not len(steps_ms):
        return
    period_ms = float(np.median(steps_ms))
    lost = 1.0 - len(steps_ms) * period_ms / float(steps_ms.sum())
    if period_ms > STEP_MS:
        yield (
            f"{path.name}: telemetry came every {period_ms:g} ms, but valves may move every {STEP_MS} ms: "
            "what they did in between is unknown, and may stay unexplained; have the firmware send "
            f"{1000 // STEP_MS} a second when you fly for a diagnosis"
        )
    if lost > LOST:
        yield f"{path.name}: {lost:.0%} of the telemetry is lost; there the valves are taken to stay put"


def _from_rest(stretch: _Telemetry) -> Iterator[_Telemetry]:
    """Runs from rest to rest; what moves before the first rest is left out."""
    time_ms = stretch.time_ms
    busy = np.flatnonzero(stretch.regulates)
    if not len(busy):
        return
    rests = np.flatnonzero(np.diff(time_ms[busy]) > LEAD_MS + TAIL_MS)
    for first, last in zip(busy[np.append(0, rests + 1)], busy[np.append(rests, len(busy) - 1)], strict=True):
        begin_ms, end_ms = time_ms[first] - LEAD_MS, time_ms[last] + TAIL_MS
        if begin_ms >= time_ms[0]:
            begin, end = np.searchsorted(time_ms, (begin_ms, min(end_ms, begin_ms + MOST_MS)))
            yield stretch.part(slice(int(begin), int(end)))


def _run(name: str, telemetry: _Telemetry) -> RecordedRun:
    since_ms = telemetry.time_ms - telemetry.time_ms[0]
    read = np.append(True, np.diff(since_ms // READING_MS) > 0)
    moved = np.append(True, np.any(np.diff(telemetry.valves, axis=0) != 0.0, axis=1))

    def kept(values: Array) -> Array:
        column = np.ascontiguousarray(values[read | moved])
        column.flags.writeable = False
        return column

    evp, dvp, solenoid = telemetry.valves.T
    return RecordedRun(
        name=name,
        time_s=kept(since_ms / 1000.0),
        command_kPa=kept(np.where(telemetry.regulates, telemetry.setpoint_kPa, np.nan)),
        evp_opening=kept(evp),
        dvp_opening=kept(dvp),
        solenoid=kept(solenoid),
        cv_kPa=kept(np.where(read, telemetry.cv_kPa, np.nan)),
        reservoir_kPa=kept(np.where(read, telemetry.reservoir_kPa, np.nan)),
        ambient_kPa=None if np.isnan(telemetry.ambient_kPa).any() else kept(telemetry.ambient_kPa),
        ambient_C=None,
        to_atmosphere=False,
    )
