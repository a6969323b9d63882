"""The layout of a text file of numbers: encoding, separator, decimal mark, header line, rows.

The separator and the decimal mark are those with which most cells of most rows are numbers or clock times.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np

from flying_vines.files.bounded import TABLE_BYTES, read_bytes
from flying_vines.identification.recording import MISSING, CaseError, counted
from flying_vines.physics.arrays import Array

Separator = Literal[",", ";", "\t", " ", "|"]
Decimal = Literal[".", ","]
_LAYOUTS: tuple[tuple[Separator, Decimal], ...] = (
    (",", "."),
    (";", "."),
    (";", ","),
    ("\t", "."),
    ("\t", ","),
    ("|", "."),
    (" ", "."),
    (" ", ","),
)
"""`" "` means one or more blanks. The first of several equally good layouts is used."""
_GUESS_ROWS = 500
_MIN_ROWS = 3
_MAX_COLUMNS = 1000
_MISSING = MISSING | {"#n/a", "-", "--", "---", "inf", "-inf", "ovf"}
_SWITCH = {"true": 1.0, "on": 1.0, "open": 1.0, "false": 0.0, "off": 0.0, "closed": 0.0, "shut": 0.0}
_PLAIN = re.compile(r"[+-]?(\d{1,15}\.?\d{0,20}|\.\d{1,20})([eE][+-]?\d{1,2})?")
_GROUPED = re.compile(r"[+-]?\d{1,3}([,.' \u00a0\u202f])\d{3}(\1\d{3})*([.,]\d+)?")
_WITH_UNIT = re.compile(r"([+-]?[\d.,]*\d)\s*([a-zA-Z%°µ]{1,5})")
_DATE = re.compile(r"(\d{4})-(\d\d?)-(\d\d?)|(\d\d?)\.(\d\d?)\.(\d{4})|(\d\d?)/(\d\d?)/(\d{4})")
_CLOCK = re.compile(r"(?:(\d{1,2}):)?(\d{1,2}):(\d{2}(?:[.,]\d{1,9})?)\s*([aApP][mM])?(?:Z|[+-]\d\d:?\d\d)?")
_COMMENT = re.compile(r"^\s*(#+|%+|//+|!+)\s*")
_BINARY = {
    b"PK\x03\x04": "a spreadsheet or an archive",
    b"\x89HDF": "an HDF5 file",
    b"MATLAB": "a MATLAB file",
}


class TextLayout(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How a file is written; a part of the answers file."""

    encoding: str
    separator: Separator
    decimal: Decimal
    header_line: Annotated[int, msgspec.Meta(ge=0)]
    """0: no header."""


@dataclass(frozen=True)
class ForeignTable:
    """The cells of a file, by columns."""

    path: Path
    layout: TextLayout
    names: tuple[str, ...]
    """Empty strings if there is no header."""
    cells: tuple[tuple[str, ...], ...]
    remarks: tuple[str, ...]

    def numbers(self, column: int) -> Array:
        """A column as numbers, clock times in seconds; NaN for all other cells. `column` counts from 0."""
        cells = self.cells[column]
        values = np.array([_value(cell, self.layout.decimal) for cell in cells], dtype=np.float64)
        if self.is_clock(column) and not any(_DATE.match(cell.strip()) for cell in cells):
            midnight = np.cumsum(np.diff(values, prepend=values[:1]) < -43_200.0)
            values = values + 86_400.0 * midnight
        return values

    def is_clock(self, column: int) -> bool:
        """True if most cells of a column are clock times."""
        found = sum(_clock(cell.strip()) is not None for cell in self.cells[column])
        return 2 * found > len(self.cells[column])

    def unit_text(self, column: int) -> str:
        """The unit written behind the numbers of a column; empty if there is none."""
        found = Counter(m[2] for cell in self.cells[column] if (m := _WITH_UNIT.fullmatch(cell.strip())))
        unit, count = found.most_common(1)[0] if found else ("", 0)
        return unit if 2 * count > len(self.cells[column]) else ""


def read_foreign(path: Path, layout: TextLayout | None = None) -> ForeignTable:
    """The table in a text file of any layout. CaseError if there is none.

    Args:
        path: the file.
        layout: how it is written; default: a guess.
    """
    try:
        data = read_bytes(path, TABLE_BYTES)
    except OSError as error:
        raise CaseError(f"{path}: cannot be read: {error.strerror}") from None
    text, encoding = _decoded(path, data, layout.encoding if layout else None)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    separator, decimal = (layout.separator, layout.decimal) if layout else _marks(path, lines)
    rows = {at: _split(line, separator) for at, line in enumerate(lines) if line.strip(" \t,;|")}
    data_rows = {at: row for at, row in rows.items() if _share(row, decimal) >= 0.5}
    if layout and layout.header_line:
        data_rows = {at: row for at, row in data_rows.items() if at >= layout.header_line}
    width = _width(data_rows.values())
    remarks = []
    first = next((at for at, row in data_rows.items() if len(row) == width), 0)
    kept = {at: row for at, row in data_rows.items() if at >= first and _fits(row, width)}
    last = next(reversed(data_rows), -1)
    if last in kept and len(kept[last]) < width and lines[-1]:
        del kept[last]  # the recording ends within this line
    if len(kept) < _MIN_ROWS or width == 0:
        raise CaseError(f"{path}: contains fewer than {_MIN_ROWS} rows of numbers; save the recording as CSV")
    if width > _MAX_COLUMNS:
        raise CaseError(f"{path}: has {width} columns; at most {_MAX_COLUMNS} can be read")
    if skipped := sum(at > first for at in rows) + 1 - len(kept):
        left_out = counted(skipped, "line")
        remarks.append(f"{path.name}: left out {left_out} without numbers below the first row")
    header, names = _header(lines, first, width, separator, layout.header_line if layout else None)
    padded = ([*row[:width], *[""] * (width - len(row))] for row in kept.values())
    cells = tuple(zip(*padded, strict=True))
    while len(cells) > 1 and not names[len(cells) - 1] and not any(cell.strip() for cell in cells[-1]):
        cells = cells[:-1]
    found = TextLayout(encoding, separator, decimal, header)
    return ForeignTable(path, found, tuple(names[: len(cells)]), cells, tuple(remarks))


def _decoded(path: Path, data: bytes, encoding: str | None) -> tuple[str, str]:
    """The text and the name of its encoding."""
    kind = next((kind for magic, kind in _BINARY.items() if data.startswith(magic)), None)
    if kind:
        raise CaseError(f"{path}: is {kind}, not text; save the recording as CSV")
    if encoding is None and data.startswith((b"\xff\xfe", b"\xfe\xff")):
        encoding = "utf-16"
    for tried in (encoding,) if encoding else ("utf-8", "cp1252", "latin-1"):
        try:
            text = data.decode("utf-8-sig" if tried == "utf-8" else tried)
        except (UnicodeError, LookupError):
            continue
        strange = sum(not c.isprintable() and c not in "\t\r\n\x0c\x1a" for c in text[:10_000])
        if strange > 0.01 * len(text[:10_000]):
            break
        return text.replace("\x1a", "").replace("\0", ""), tried
    raise CaseError(f"{path}: is not a text file; save the recording as CSV in UTF-8")


def _marks(path: Path, lines: Sequence[str]) -> tuple[Separator, Decimal]:
    sample = [line for line in lines if line.strip(" \t,;|")][: _GUESS_ROWS + 100]
    if not sample:
        raise CaseError(f"{path}: is empty; record again")
    scores = {marks: _score(sample, *marks) for marks in _LAYOUTS}
    return max(scores, key=lambda marks: scores[marks])


def _score(lines: Sequence[str], separator: Separator, decimal: Decimal) -> float:
    """Number of cells that are values; other cells, and numbers with grouped digits, are subtracted."""
    rows = [row for line in lines if _share(row := _split(line, separator), decimal) >= 0.5]
    width = _width(rows)
    score = 0.0
    for row in rows:
        if _fits(row, width):
            cells = [cell.strip() for cell in row if cell.strip().casefold() not in _MISSING]
            values = [cell for cell in cells if _value(cell, decimal) == _value(cell, decimal)]
            grouped = sum(
                _GROUPED.fullmatch(cell) is not None for cell in values if not _plain(cell, decimal)
            )
            score += len(values) - 2.0 * (len(cells) - len(values)) - 0.6 * grouped
    return score


def _width(rows: Iterable[Sequence[str]]) -> int:
    """The most common number of cells."""
    counts = Counter(len(row) for row in rows)
    return max(counts, key=lambda width: (counts[width], width), default=0)


def _fits(row: Sequence[str], width: int) -> bool:
    """True if a row has as many cells as there are columns; some may be missing or empty at its end."""
    return 2 * len(row) > width and not any(cell.strip() for cell in row[width:])


def _share(row: Sequence[str], decimal: Decimal) -> float:
    """Share of values among the cells of a row that are not empty."""
    cells = [cell.strip() for cell in row if cell.strip().casefold() not in _MISSING]
    return sum(_value(cell, decimal) == _value(cell, decimal) for cell in cells) / max(1, len(cells))


def _split(line: str, separator: Separator) -> list[str]:
    if separator == " ":
        return line.split()
    if '"' not in line:
        return line.split(separator)
    try:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:
        return []


def _value(cell: str, decimal: Decimal) -> float:
    """The number or the clock time (in seconds) in a cell; NaN if there is none."""
    cell = cell.strip()
    if cell.casefold() in _MISSING:
        return float("nan")
    if plain := _plain(cell, decimal):
        return float(plain)
    if (clock := _clock(cell)) is not None:
        return clock
    if grouped := _GROUPED.fullmatch(cell):
        # The last dot of 1.003.000 counts as the decimal point: 1003.000 ms and 1003000 µs are the same time.
        head, tail = cell.rpartition(decimal)[::2] if grouped[1] == decimal else (cell, "")
        digits = _plain(head.replace(grouped[1], ""), decimal)
        return float(f"{digits}.{tail}" if tail.isdecimal() else digits) if digits else float("nan")
    if with_unit := _WITH_UNIT.fullmatch(cell):
        plain = _plain(with_unit[1], decimal)
        return float(plain) if plain else float("nan")
    return _SWITCH.get(cell.casefold(), float("nan"))


def _plain(cell: str, decimal: Decimal) -> str:
    """The cell as Python writes it, or an empty string if it is not a plain number."""
    if decimal == ",":
        if "." in cell:
            return ""
        cell = cell.replace(",", ".")
    return cell if _PLAIN.fullmatch(cell) else ""


def _clock(cell: str) -> float | None:
    """Seconds of `14:38:23.5`, `2019-11-29T14:38:23` or `29.11.2019 2:38:23 PM`.

    They count from midnight; with a date, from a fixed day.
    """
    if ":" not in cell:
        return None
    day, rest = 0.0, cell
    if found := _DATE.match(cell):
        rest = cell[found.end() :].lstrip("T ,")
        y, m, d, *others = (int(part or 0) for part in found.groups())
        if found[4]:
            d, m, y = others[:3]
        elif found[7]:
            m, d, y = others[3:]
            m, d = (d, m) if m > 12 else (m, d)
        try:
            day = 86_400.0 * date(y, m, d).toordinal()
        except ValueError:
            return None
    if (clock := _CLOCK.fullmatch(rest)) is None:
        return None
    hours, minutes, seconds, half = clock.groups()
    h = int(hours or 0)
    if half:
        h = h % 12 + 12 * (half.casefold() == "pm")
    return day + 3600.0 * h + 60.0 * int(minutes) + float(seconds.replace(",", "."))


def _header(
    lines: Sequence[str], first: int, width: int, separator: Separator, line: int | None
) -> tuple[int, list[str]]:
    """Line number of the header (from 1, 0 if there is none) and the names of the columns."""
    above = [at for at in range(first) if lines[at].strip(" \t,;|")]
    tried = reversed(above[-3:]) if line is None else [line - 1] if 0 < line <= len(lines) else []
    units: list[str] | None = None
    for at in tried:
        names = _names(lines[at], width, separator)
        if names is None:
            continue
        if line is None and units is None and at != above[0] and all(_is_unit_cell(name) for name in names):
            units = names
            continue
        if units:
            names = [f"{name} [{unit.strip('[]() ')}]" for name, unit in zip(names, units, strict=True)]
        return at + 1, names
    return (0, units) if units else (0, [""] * width)


def _is_unit_cell(name: str) -> bool:
    return len(name.strip("[]() ")) <= 5 and not re.search(r"\d{2}|time|pwm", name, re.IGNORECASE)


def _names(line: str, width: int, separator: Separator) -> list[str] | None:
    """The cells of a header line; None if it has no name for each column."""
    line = _COMMENT.sub("", line)
    ways = [_split(line, separator), re.split(r"\t|\s{2,}", line.strip()), *(line.split(s) for s in ",;")]
    ways.append([part[0] for part in re.finditer(r"\S+(\s+[(\[][^)\]]*[)\]])?", line)])
    for cells in ways:
        names = [cell.strip(" \"'") for cell in cells]
        while len(names) > width and not names[-1]:
            del names[-1]
        words = sum(bool(re.search(r"[^\W\d_]|[%°]", name)) for name in names)
        if len(names) == width and words and 2 * words >= len([n for n in names if n]):
            return names
        if len(names) > width > 1 and words == len(names) and separator != " ":
            return names[:width]
        if width > 1 and len(names) == width - 1 and words == len(names) and separator != " ":
            return [*names, ""]
    return None
