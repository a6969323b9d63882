"""A recorded run of a rig, the CSV file that it is read from, and the error for one that cannot be used.

The header of the file is the first line with `time_s` in it; it may be a comment. Separators are commas,
semicolons or tabs; numbers have a decimal point. Empty lines and lines that start with `#` are skipped.
Errors name file, line and column.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from flying_vines.files.bounded import TABLE_BYTES, read_bytes
from flying_vines.files.toml_text import one_line, read_text
from flying_vines.physics.arrays import Array, BoolArray


class CaseError(ValueError):
    """A case cannot be read. Its text is one line: where, what is wrong, and what to do."""

    def __init__(self, text: str) -> None:
        super().__init__(one_line(text))


def counted(count: int, name: str) -> str:
    """`1 row` or `2 rows`."""
    return f"{count} {name}{'' if count == 1 else 's'}"


@dataclass(frozen=True, eq=False)
class RecordedRun:
    """One recorded run. All arrays have one element for each sample and are read-only; pressures are gauge.

    Time rises strictly. An input holds until the next sample. A pressure is NaN where there is no reading,
    and all NaN if it was not recorded; at least one pressure was recorded. EVP is the inflation valve, DVP
    the valve that supplies the Venturi.
    """

    name: str
    """File name without its ending."""
    time_s: Array
    command_kPa: Array | None
    """NaN while the regulator was off; None if it was not recorded."""
    evp_opening: Array
    dvp_opening: Array
    solenoid: Array
    """0 shut, 1 open."""
    cv_kPa: Array
    reservoir_kPa: Array
    ambient_kPa: Array | None
    """Absolute; linear between readings."""
    ambient_C: Array | None
    """Linear between readings."""
    to_atmosphere: bool
    """No control volume: the inflation valve discharges to atmosphere."""
    after_gap: Array | None = None
    """1 at a sample whose pressures do not follow from the previous sample, for example because a valve
    moved at an unknown time; otherwise 0. None if there is no such sample."""


TIME = "time_s"
_SEPARATORS = (",", ";", "\t")
MISSING = frozenset({"", "nan", "na", "n/a", "null", "none"})
"""Cells without a reading."""
_WORDS = {"false": "0", "true": "1"}
_COMMENT = re.compile(r"\s*#\s*")
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")


@dataclass(frozen=True)
class RunTable:
    """The cells of a file, by column name."""

    path: Path
    header: str
    """`file:line` of the header."""
    columns: Mapping[str, Sequence[str]]
    lines: Sequence[int]
    """Line number of each row in the file."""
    remarks: Sequence[str]

    def numbers(self, name: str) -> Array:
        """A column; NaN where a cell is empty."""
        cells = self.columns[name]
        try:
            values = np.array([float(cell) for cell in cells], dtype=np.float64)
        except ValueError:
            values = np.array([self._number(row, name) for row in range(len(cells))], dtype=np.float64)
        self.refuse(name, np.isinf(values), "is not a finite number; leave the cell empty")
        # Python reads 1_0 as ten.
        self.refuse(name, np.array(["_" in cell for cell in cells], dtype=bool), "is not a number")
        return values

    def switches(self, name: str, no: str = "shut", yes: str = "open") -> Array:
        """A column of 0 and 1, or false and true; NaN where a cell is empty."""
        words = [_WORDS.get(cell.strip().casefold(), cell) for cell in self.columns[name]]
        values = replace(self, columns={name: words}).numbers(name)
        odd = ~np.isnan(values) & (values != 0.0) & (values != 1.0)
        self.refuse(name, odd, f"is neither 0 ({no}) nor 1 ({yes}); check the column names")
        return values

    def refuse(self, name: str, odd: BoolArray, why: str) -> None:
        """CaseError about the first cell of a column that is `odd`."""
        if odd.any():
            row = int(np.argmax(odd))
            raise CaseError(f"{self.place(row, name)}: {_short(self.columns[name][row])} {why}")

    def place(self, row: int, name: str) -> str:
        """The place of a cell, for error texts."""
        return f"{self.path}:{self.lines[row]}: {name}"

    def _number(self, row: int, name: str) -> float:
        cell = self.columns[name][row].strip()
        try:
            return float("nan" if cell.casefold() in MISSING else cell)
        except ValueError:
            comma = "has a decimal comma; write the numbers with a decimal point"
            why = "is not a number; leave the cell empty if there was no reading"
            why = comma if _DECIMAL_COMMA.fullmatch(cell) else why
            raise CaseError(f"{self.place(row, name)}: {_short(cell)} {why}") from None


def read_table(path: Path) -> RunTable:
    """The cells of a CSV file. CaseError if it is not one."""
    lines = _lines_of(path)
    at, separator, names = _header(path, lines)
    header = f"{path}:{at + 1}"
    while names and not names[-1]:
        del names[-1]
    for name in names:
        if name and names.count(name) > 1:
            raise CaseError(f"{header}: two columns are named {name}; remove one")
    remarks = []
    if any(_is_content(line) for line in lines[:at]):
        remarks.append(f"{path.name}: the lines above the column names are ignored")
    kept = [number for number in range(at + 1, len(lines)) if _is_content(lines[number])]
    rows = list(_rows(path, lines, kept, separator))
    if rows and (len(rows[-1]) < len(names) or (lines[-1] and _is_cut_off(rows))):
        remarks.append(f"{path.name}: the last line is incomplete and left out")
        del rows[-1], kept[-1]
    for number, row in zip(kept, rows, strict=True):
        if len(row) < len(names) or any(cell.strip() for cell in row[len(names) :]):
            raise CaseError(
                f"{path}:{number + 1}: has {len(row)} cells, but there are {len(names)} columns; "
                "write one cell for each column, and numbers with a decimal point"
            )
    cells = list(zip(*rows, strict=False)) or [()] * len(names)
    columns = dict(zip(names, cells, strict=False))
    return RunTable(path, header, columns, [number + 1 for number in kept], remarks)


def has_header(path: Path) -> bool:
    """True if a line of the file names the columns. Raises `OSError`."""
    lines = read_bytes(path, TABLE_BYTES).decode("utf-8-sig", errors="replace").splitlines()
    return any(_column_names(line, comment) for line in lines for comment in (False, True))


def _rows(path: Path, lines: Sequence[str], kept: Sequence[int], separator: str) -> Iterator[list[str]]:
    """The cells of each line in `kept` (numbered from 0)."""
    reader = csv.reader((lines[number] for number in kept), delimiter=separator)
    for index, number in enumerate(kept):
        try:
            row = next(reader)
        except csv.Error as error:
            raise CaseError(f"{path}:{number + 1}: is not a CSV line: {error}") from None
        if reader.line_num != index + 1:
            raise CaseError(f"{path}:{number + 1}: a quotation mark is not closed; remove it")
        yield row


def _is_cut_off(rows: Sequence[Sequence[str]]) -> bool:
    """True if the last number has fewer decimals than all others: it was not written to its end."""
    *others, last = (len(row[-1].strip().partition(".")[2]) for row in rows)
    return len(set(others)) == 1 and len(rows[-1][-1].strip()) > 0 and last < others[0]


def _header(path: Path, lines: Sequence[str]) -> tuple[int, str, list[str]]:
    """Line number of the header (from 0), separator, and column names."""
    for comment in (False, True):
        for at, line in enumerate(lines):
            if names := _column_names(line, comment):
                return at, *names
    raise CaseError(_no_header(path, lines))


def _column_names(line: str, comment: bool) -> tuple[str, list[str]] | None:
    """Separator and column names of a header. `comment`: only a comment counts, without its mark."""
    if TIME not in line or (comment and _COMMENT.match(line) is None):
        return None
    separator, cells = _cells(_COMMENT.sub("", line) if comment else line)
    names = [name.strip() for name in cells]
    return (separator, names) if TIME in names else None


def _lines_of(path: Path) -> list[str]:
    text = read_text(path, CaseError, most_bytes=TABLE_BYTES)
    if "\0" in text:
        raise CaseError(f"{path}: is not a text file; save the recording as CSV in UTF-8")
    return text.split("\n")


def _is_content(line: str) -> bool:
    """False for a comment, an empty line, and an empty spreadsheet row (separators only)."""
    bare = line.strip(" \t,;")
    return bool(bare) and not bare.startswith("#")


def _cells(line: str) -> tuple[str, list[str]]:
    """The most frequent separator of a line, and its cells."""
    separator = max(_SEPARATORS, key=line.count)
    try:
        return separator, next(csv.reader([line], delimiter=separator), [])
    except csv.Error:
        return separator, []


def _no_header(path: Path, lines: Sequence[str]) -> str:
    """The error text if there is no header."""
    contents = [(number, line) for number, line in enumerate(lines, start=1) if _is_content(line)]
    if not contents:
        return f"{path}: is empty; remove it, or record again"
    number, line = contents[0]
    _, names = _cells(line)
    need = "the first line must name the columns: time_s, evp_opening, cv_pressure_kPa and so on"
    try:
        float(names[0].strip().replace(",", "."))
    except ValueError:
        return f"{path}:{number}: there is no column {TIME} among {_short(', '.join(names), 60)}; {need}"
    return f"{path}:{number}: the columns have no names; {need}"


def _short(text: str, max_length: int = 30) -> str:
    return repr(text if len(text) <= max_length else text[: max_length - 1] + "…")
