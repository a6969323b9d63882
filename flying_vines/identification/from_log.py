"""A flight log as a case: the runs in its telemetry, each from rest to rest.

    case = read_flight("flights/2026-05-04_10-30-00")       the flight's folder, or its flight.mcap

The valve commands in a telemetry message apply from its time on. All commands are known if a message comes
with every step of the firmware's regulator. If messages come less often, a remark says so. Time is the
firmware's clock, because the host's clock includes the delays of the link.

Readings are used every few milliseconds; valve commands are used whenever they change. A reading must not be
selected because a valve moved: the regulator moves valves because of its readings, so such a selection would
bias the noise. EVP is the inflation valve, DVP the valve that supplies the Venturi.
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
from flying_vines.physics.arrays import Array, BoolArray
from flying_vines.physics.rig import Rig, RigError, load_rig, rig_from
from flying_vines.record.reader import FlightLog, LogError, refuses_foreign
from flying_vines.record.topics import SNAPSHOT, START, TELEMETRY

STEP_MS = 1
"""Step of the firmware's regulator: the shortest time between two valve movements."""
READING_MS = 5
"""Time between the readings that are used."""
PAUSE_MS = 300
"""A longer gap in the telemetry ends a run, because the state after it is unknown."""
LEAD_MS = 1000
"""Length of the rest at the start of a run."""
TAIL_MS = 5000
"""Length of the rest at the end of a run, in which the gas returns to ambient temperature."""
MAX_MS = 180_000
"""Maximum total length of the runs. Of a longer flight only every n-th run is used; a longer run is cut."""
MAX_LOST = 0.01
"""A larger share of lost telemetry gives a remark."""
_WRAP_MS = 1 << 32
AIR_KPA = (40.0, 115.0)
"""Range of a working barometer, kPa absolute."""
_FIELDS = ("t", "device_time_ms", "mode", "faults", "setpoint_kPa", "cv_kPa", "reservoir_kPa")
_VALVES = ("evp_opening", "dvp_opening", "solenoid")


class _Telemetry(NamedTuple):
    """Successive telemetry messages; one element of each array belongs to one message."""

    time_ms: NDArray[np.int64]
    """Firmware's clock, unwrapped."""
    regulates: BoolArray
    setpoint_kPa: Array
    cv_kPa: Array
    reservoir_kPa: Array
    """NaN while a latched fault names the sensor: the firmware then repeats the last good reading."""
    valves: Array
    """(n, 3): openings of EVP and DVP, and the solenoid."""
    ambient_kPa: Array
    """Absolute; NaN if it was not measured."""

    def part(self, which: slice | BoolArray) -> _Telemetry:
        return _Telemetry._make(values[which] for values in self)

    @property
    def length_ms(self) -> int:
        return int(self.time_ms[-1] - self.time_ms[0])


def read_flight(path: Path | str, rig: Path | str | None = None) -> Case:
    """The case in a flight log.

    Args:
        path: the log, the flight's folder, or `last` in a folder of flights.
        rig: a rig file; default: the nominal rig that the log contains.

    Raises CaseError if it cannot be read, or contains no rig or no run.
    """
    try:
        flight = FlightLog(Path(path))
    except LogError as error:
        raise CaseError(str(error)) from None
    path = flight.path
    log = _read(flight)
    nominal = _nominal(path, log.tables, rig)
    stretches = list(_stretches(log))
    remarks = [*_telemetry_remarks(path, stretches)]
    if log.unknown:
        total = len(log.telemetry) + log.unknown
        remarks.append(
            f"{path.name}: {log.unknown} of {total} telemetry messages are incomplete and left out"
        )
    if flight.damage:
        remarks.append(flight.damage)
    flown = [run for stretch in stretches for run in _from_rest(stretch)]
    if not flown:
        raise CaseError(
            f"{path}: no setpoint was held after {LEAD_MS / 1000:g} s of rest; fly some bends, "
            "the first from a vented vine"
        )
    every = ceil(sum(run.length_ms for run in flown) / MAX_MS)
    if every > 1:
        remarks.append(
            f"{path.name}: {len(flown[::every])} of {len(flown)} runs are used, from all over the flight"
        )
    runs = [_run(f"flight_{number}", run) for number, run in enumerate(flown[::every], start=1)]
    return Case(path, nominal, tuple(runs), tuple(remarks))


class _Log(NamedTuple):
    tables: Any
    """The nominal rig, as the tables of a rig file."""
    telemetry: Array
    """(n, 10), columns in the order of `_FIELDS` and `_VALVES`."""
    ambient: Array
    """(m, 2): time and pressure, kPa absolute."""
    unknown: int
    """Number of telemetry messages in which a number is missing or not finite."""


def _read(flight: FlightLog) -> _Log:
    tables: Any = None
    rows: list[list[float]] = []
    ambient: list[list[float]] = []
    unknown = 0
    try:
        with refuses_foreign(flight):
            for entry in flight.entries((START, TELEMETRY, SNAPSHOT)):
                content = entry.fields
                if entry.topic == START:
                    tables = content.get("believed")
                elif entry.topic == TELEMETRY:
                    row = _numbers(content, (*_FIELDS, *_VALVES))
                    if row is None:
                        unknown += 1
                    else:
                        rows.append(row)
                elif (air := _numbers(content, ("t", "ambient_kPa"))) and AIR_KPA[0] <= air[1] <= AIR_KPA[1]:
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


def _nominal(path: Path, tables: Any, rig: Path | str | None) -> Rig:
    try:
        if rig is not None:
            nominal = load_rig(rig)
            if nominal.cv is None:
                raise CaseError(f"{rig}: a flight has a control volume; add [cv] with its volume_L")
            return nominal
        if not isinstance(tables, Mapping):
            raise CaseError(f"{path}: contains no nominal rig; give --rig RIG.toml")
        return rig_from({name: table for name, table in tables.items() if table is not None})
    except RigError as error:
        raise CaseError(str(error) if rig is not None else f"{path}: {error}") from None


def _stretches(log: _Log) -> Iterator[_Telemetry]:
    """Parts of the log without a pause."""
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
    # A clock that runs backwards without a wrap: the firmware has restarted.
    cuts = np.flatnonzero((step_ms > PAUSE_MS) | (step_ms < 0)) + 1
    for first, last in pairwise((0, *cuts.tolist(), len(rows))):
        stretch = whole.part(slice(first, last))
        yield stretch.part(np.append(np.diff(stretch.time_ms) > 0, True))


def _telemetry_remarks(path: Path, stretches: Sequence[_Telemetry]) -> Iterator[str]:
    """Properties of the telemetry that limit a verdict."""
    steps_ms = np.concatenate([np.diff(stretch.time_ms) for stretch in stretches])
    if not len(steps_ms):
        return
    period_ms = float(np.median(steps_ms))
    lost = 1.0 - len(steps_ms) * period_ms / float(steps_ms.sum())
    if period_ms > STEP_MS:
        yield (
            f"{path.name}: telemetry came every {period_ms:g} ms, but valves may move every {STEP_MS} ms: "
            "movements in between are unknown and may stay unexplained; set telemetry_Hz = "
            f"{1000 // STEP_MS} in the firmware before you fly for a diagnosis"
        )
    if lost > MAX_LOST:
        yield f"{path.name}: {lost:.0%} of the telemetry is lost; there the valves are assumed not to move"


def _from_rest(stretch: _Telemetry) -> Iterator[_Telemetry]:
    """Runs from rest to rest. Movements before the first rest are left out."""
    time_ms = stretch.time_ms
    busy = np.flatnonzero(stretch.regulates)
    if not len(busy):
        return
    rests = np.flatnonzero(np.diff(time_ms[busy]) > LEAD_MS + TAIL_MS)
    for first, last in zip(busy[np.append(0, rests + 1)], busy[np.append(rests, len(busy) - 1)], strict=True):
        begin_ms, end_ms = time_ms[first] - LEAD_MS, time_ms[last] + TAIL_MS
        if begin_ms >= time_ms[0]:
            begin, end = np.searchsorted(time_ms, (begin_ms, min(end_ms, begin_ms + MAX_MS)))
            yield stretch.part(slice(int(begin), int(end)))


def _run(name: str, telemetry: _Telemetry) -> RecordedRun:
    since_ms = telemetry.time_ms - telemetry.time_ms[0]
    read = np.append(True, np.diff(since_ms // READING_MS) > 0)
    moved = np.append(True, np.any(np.diff(telemetry.valves, axis=0) != 0.0, axis=1))

    def selected(values: Array) -> Array:
        column = np.ascontiguousarray(values[read | moved])
        column.flags.writeable = False
        return column

    evp, dvp, solenoid = telemetry.valves.T
    return RecordedRun(
        name=name,
        time_s=selected(since_ms / 1000.0),
        command_kPa=selected(np.where(telemetry.regulates, telemetry.setpoint_kPa, np.nan)),
        evp_opening=selected(evp),
        dvp_opening=selected(dvp),
        solenoid=selected(solenoid),
        cv_kPa=selected(np.where(read, telemetry.cv_kPa, np.nan)),
        reservoir_kPa=selected(np.where(read, telemetry.reservoir_kPa, np.nan)),
        ambient_kPa=None if np.isnan(telemetry.ambient_kPa).any() else selected(telemetry.ambient_kPa),
        ambient_C=None,
        to_atmosphere=False,
    )
