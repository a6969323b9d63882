"""A case: a folder of recorded runs of a rig, and its nominal rig file.

    case = read_case("cases/workshop")                  every CSV of the folder, and its rig.toml
    case = read_case("run.csv", rig="nominal.toml")     one run, and a rig from elsewhere

Each assumption made while reading is listed in `Case.remarks`. Data that cannot be a recording of this rig
raise a `CaseError`.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flying_vines.identification import plausible
from flying_vines.identification.recording import TIME, CaseError, RecordedRun, RunTable, counted, read_table
from flying_vines.physics.arrays import Array
from flying_vines.physics.rig import Rig, RigError, load_rig

__all__ = ["Case", "CaseError", "RecordedRun", "read_case"]

Rows = NDArray[np.intp]

RIG = "rig.toml"
MIN_SAMPLES = 8
"""Minimum number of samples with a pressure. The shortest discharge in the phloSAR paper has nine."""
MIN_S = 1.0
_CV, _RESERVOIR = "cv_pressure_kPa", "reservoir_pressure_kPa"
_INPUTS = ("evp_opening", "dvp_opening", "solenoid")
_PRESSURES = (_CV, _RESERVOIR)
_COLUMNS = (
    TIME,
    "command_kPa",
    *_INPUTS,
    *_PRESSURES,
    "ambient_pressure_kPa",
    "ambient_temperature_C",
    "after_gap",
)
_VALVE = r"(_(open\w*|percent|pct|duty|pwm|state))?"
_PRESSURE = r"(_pressure\w*)?(_(pa|hpa|kpa|mpa|bar|mbar|psi|psig))?"
_ALSO_CALLED = {
    "evp_opening": "evp" + _VALVE,
    "dvp_opening": "dvp" + _VALVE,
    "solenoid": "solenoid" + _VALVE,
    _CV: "cv" + _PRESSURE,
    _RESERVOIR: "reservoir" + _PRESSURE,
    "ambient_pressure_kPa": "ambient" + _PRESSURE,
    "ambient_temperature_C": r"ambient_temperature\w*",
}
"""Other common names of each column, as regular expressions. A column with such a name is an error, because a
recorded quantity must not be ignored."""


@dataclass(frozen=True, eq=False)
class Case:
    """Recorded runs, in the order of their file names, and the nominal rig."""

    path: Path
    rig: Rig
    runs: tuple[RecordedRun, ...]
    remarks: tuple[str, ...]
    """Assumptions and ignored data, one line each; empty for a case that follows the format."""


def read_case(path: Path | str, rig: Path | str | None = None) -> Case:
    """The case in a folder, or of a single CSV file.

    Args:
        path: the folder, or the file.
        rig: a rig file; default: the `rig.toml` in the folder or beside the file.

    Raises CaseError if a file cannot be read, or a column cannot be what its name says.
    """
    path = Path(path)
    files = _files_of(path)
    nominal = _rig(Path(rig) if rig is not None else (path if path.is_dir() else path.parent) / RIG)
    remarks: list[str] = []
    runs = {file: _read_run(file, nominal, remarks) for file in files}
    remarks += plausible.check(nominal, runs)
    return Case(path, nominal, tuple(runs.values()), tuple(remarks))


def _files_of(path: Path) -> list[Path]:
    try:
        if not path.exists():
            raise CaseError(f"{path}: no such folder or file")
        if not path.is_dir():
            if path.suffix.casefold() == ".toml":
                raise CaseError(f"{path}: is not a recording; give the folder with rig.toml and the runs")
            return [path]
        found = [
            file
            for file in path.iterdir()
            if file.suffix.casefold() == ".csv" and not file.name.startswith(".") and not file.is_dir()
        ]
    except OSError as error:
        raise CaseError(f"{path}: cannot be read: {error.strerror}") from None
    if not found:
        raise CaseError(f"{path}: contains no recorded run; put each run there as a .csv file")
    return sorted(found, key=_by_number)


def _by_number(file: Path) -> list[tuple[int, str]]:
    """Sort key that puts run_2 before run_10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", file.name)]


def _rig(path: Path) -> Rig:
    try:
        if not path.exists():
            raise CaseError(f"{path}: no such file; it must describe the nominal rig")
        return load_rig(path)
    except OSError as error:
        raise CaseError(f"{path}: cannot be read: {error.strerror}") from None
    except RigError as error:
        raise CaseError(str(error)) from None


def _read_run(path: Path, rig: Rig, remarks: list[str]) -> RecordedRun:
    table = read_table(path)
    remarks += table.remarks
    remarks += _unknown_columns(table)
    rows = _rows_in_time(table, remarks)

    def column(name: str) -> Array | None:
        """None if there is no such column, or no number in it."""
        if name not in table.columns:
            return None
        values = table.numbers(name)[rows]
        return None if np.isnan(values).all() else values

    time_s = table.numbers(TIME)[rows]
    cv_kPa, reservoir_kPa, command_kPa = column(_CV), column(_RESERVOIR), column("command_kPa")
    _long_enough(table, time_s, [values for values in (cv_kPa, reservoir_kPa) if values is not None])
    if rig.cv is None and cv_kPa is not None:
        raise CaseError(
            f"{table.header}: {_CV}: the rig has no control volume; add [cv] with its volume_L to the rig, "
            "or remove the column"
        )
    if reservoir_kPa is None and rig.pump is None:
        remarks.append(
            f"{path.name}: the reservoir's pressure was not recorded; not even its first value is known"
        )
    inputs = {name: values for name in _INPUTS if (values := _held(table, name, rows, remarks)) is not None}
    discharge = not inputs
    if discharge and (cv_kPa is not None or command_kPa is not None):
        raise CaseError(
            f"{table.header}: the valve commands were not recorded; only a discharge of the reservoir needs "
            f"no {', '.join(_INPUTS)}"
        )
    shut, opened, unread = np.zeros_like(time_s), np.ones_like(time_s), np.full_like(time_s, np.nan)
    run = RecordedRun(
        name=path.stem,
        time_s=time_s,
        command_kPa=command_kPa,
        evp_opening=inputs.get("evp_opening", opened if discharge else shut),
        dvp_opening=inputs.get("dvp_opening", shut),
        solenoid=inputs.get("solenoid", opened if discharge else shut),
        cv_kPa=unread if cv_kPa is None else cv_kPa,
        reservoir_kPa=unread if reservoir_kPa is None else reservoir_kPa,
        ambient_kPa=_without_holes(time_s, column("ambient_pressure_kPa")),
        ambient_C=_without_holes(time_s, column("ambient_temperature_C")),
        to_atmosphere=discharge or rig.cv is None,
        after_gap=_gaps(table)[rows] if "after_gap" in table.columns else None,
    )
    for values in vars(run).values():
        if isinstance(values, np.ndarray):
            values.flags.writeable = False
    if discharge:
        plausible.check_discharge(path, run, rig)
    if discharge and rig.cv is not None:
        remarks.append(
            f"{path.name}: no valve was recorded; assumed to be a discharge of the reservoir to atmosphere"
        )
    for name in _INPUTS:
        if not discharge and name not in inputs and not (run.to_atmosphere and name == "solenoid"):
            plausible.check_shut(path, name, run, rig)
            remarks.append(f"{path.name}: {name} was not recorded; assumed shut throughout")
    return run


def _rows_in_time(table: RunTable, remarks: list[str]) -> Rows:
    """The rows that are used: rows with a time; of several rows with the same time, only the last."""
    time_s = table.numbers(TIME)
    rows = np.flatnonzero(~np.isnan(time_s))
    if len(rows) < len(time_s):
        left_out = counted(len(time_s) - len(rows), "row")
        remarks.append(f"{table.path.name}: left out {left_out} without a time")
    steps_s = np.diff(time_s[rows])
    if (steps_s < 0.0).any():
        before, after = rows[np.argmax(steps_s < 0.0) :][:2]
        raise CaseError(
            f"{table.place(int(after), TIME)}: time runs backwards, from {time_s[before]:.6g} to "
            f"{time_s[after]:.6g} s; save each run in its own file, with its rows in order of time"
        )
    again = int((steps_s == 0.0).sum())
    if 2 * again > len(steps_s):
        raise CaseError(
            f"{table.path}: {TIME}: {again} of {len(rows)} rows have the time of the previous row; "
            "write the time with more digits"
        )
    if again:
        remarks.append(f"{table.path.name}: left out {counted(again, 'row')} with the time of the next row")
    return rows[np.append(steps_s > 0.0, True)] if len(rows) else rows


def _long_enough(table: RunTable, time_s: Array, pressures: Sequence[Array]) -> None:
    if len(time_s) and not pressures:
        raise CaseError(f"{table.header}: no pressure was recorded; a run needs {_CV} or {_RESERVOIR}")
    readings = np.isfinite(pressures).any(axis=0) if len(time_s) else np.zeros(0, dtype=bool)
    span_s = float(np.ptp(time_s[readings])) if readings.any() else 0.0
    if readings.sum() < MIN_SAMPLES or span_s < MIN_S:
        raise CaseError(
            f"{table.path}: {readings.sum()} samples in {span_s:.3g} s are too few; a run needs at least "
            f"{MIN_SAMPLES} samples and {MIN_S:g} s; record longer, or remove the file"
        )


def _held(table: RunTable, name: str, rows: Rows, remarks: list[str]) -> Array | None:
    """An input; an empty cell repeats the value before it (0 at the start). None if all cells are empty."""
    if name not in table.columns:
        return None
    values = table.switches(name) if name == "solenoid" else table.numbers(name)
    odd = (values < 0.0) | (values > 1.0)
    table.refuse(name, odd, "is outside 0…1; divide a percentage by 100")
    empty = np.isnan(values)
    if empty[rows].all():
        return None
    if count := int(empty[rows].sum()):
        cells = counted(count, "empty cell")
        remarks.append(f"{table.path.name}: {name}: {cells}, filled with the value before")
    last = np.maximum.accumulate(np.where(empty, -1, np.arange(len(values))))
    return np.where(last < 0, 0.0, values[last])[rows]


def _gaps(table: RunTable) -> Array:
    return np.nan_to_num(table.switches("after_gap", "follows from the row before", "after a gap"))


def _without_holes(time_s: Array, values: Array | None) -> Array | None:
    if values is None:
        return None
    there = np.isfinite(values)
    return np.interp(time_s, time_s[there], values[there])


def _unknown_columns(table: RunTable) -> Iterator[str]:
    """Remarks on unknown columns; CaseError if one is a known column under another name."""
    absent = [name for name in _COLUMNS if name not in table.columns]
    for name in table.columns:
        if name in _COLUMNS:
            continue
        if meant := _meant(name, absent):
            raise CaseError(
                f"{table.header}: column {name!r}: did you mean {meant}? Rename it and use its unit, "
                "or remove the column"
            )
        called = f"column {name!r}" if name else "a column without a name"
        yield f"{table.path.name}: {called} is ignored"


def _meant(name: str, absent: Sequence[str]) -> str | None:
    plain = re.sub(r"\W+", "_", name).strip("_").casefold()
    for known in absent:
        if known in _ALSO_CALLED and re.fullmatch(_ALSO_CALLED[known], plain):
            return known
    near = difflib.get_close_matches(plain, [known.casefold() for known in absent], n=1, cutoff=0.9)
    return next((known for known in absent if known.casefold() in near), None)
