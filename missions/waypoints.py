"""Read and write QGC WPL files, the plain-text plan format that every ground station reads.

A header line, then one line per item: seq, current, frame, command, param1…4, x (latitude), y (longitude), z,
autocontinue, separated by tabs. A file has the items as the autopilot stores them: on ArduPilot the first is
home; on PX4 there is no home item. (QGroundControl always reads the first item as home, so use a `.plan` for
PX4. QGroundControl's own files without home have version 120, which MAVProxy refuses.)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from flying_vines.files.toml_text import read_text
from flying_vines.vehicle.mission.item import MAX_NUMBER, MissionItem

_HEADER = "QGC WPL 110"
_WITHOUT_HOME = "QGC WPL 120"
_COLUMNS = 12
_UINT16 = 65535
_UINT8 = 255


class WaypointsError(ValueError):
    """A file cannot be read, or items cannot be written; the text gives the line and the reason."""


def read_waypoints(path: str | Path) -> list[MissionItem]:
    """The items of the file, in order; their seq counts up from 0.

    Blank lines and comments (#) are skipped, any white space may separate columns, and `nan` is a number.

    Raises:
        WaypointsError: the file cannot be read; wrong header or column count, not a number, number out of
            range, or seq out of order.
    """
    lines = read_text(Path(path), WaypointsError).split("\n")
    found = lines[0].strip()
    if found.split() not in (_HEADER.split(), _WITHOUT_HOME.split()):
        if found.startswith("{"):
            raise WaypointsError(
                f"{path}: this is JSON, not a waypoint file: open it in QGroundControl, and save it as .plan"
            )
        headers = f"{_HEADER!r} or {_WITHOUT_HOME!r}"
        raise WaypointsError(f"{path}, line 1: the header must be {headers}, not {found[:40]!r}")
    items: list[MissionItem] = []
    for number, line in enumerate(lines[1:], start=2):
        if line.strip() and not line.lstrip().startswith("#"):
            items.append(_Line(f"{path}, line {number}", line.split()).item(len(items)))
    return items


def write_waypoints(path: str | Path, items: Sequence[MissionItem]) -> None:
    """Write the items; `read_waypoints` reads back exactly the same numbers.

    Raises:
        WaypointsError: the items' seq does not count up from 0.
        OSError: the file cannot be written.
    """
    lines = [_HEADER]
    for seq, item in enumerate(items):
        if item.seq != seq:
            raise WaypointsError(f"{path}, line {seq + 2}: seq must be {seq}, not {item.seq}")
        p1, p2, p3, p4, x, y, z = map(_number, item.params)
        columns = [str(seq), str(int(item.current)), str(item.frame), str(item.command)]
        columns += [p1, p2, p3, p4, x, y, z, str(int(item.autocontinue))]
        lines.append("\t".join(columns))
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")


def _number(value: float) -> str:
    # repr gives the shortest text that reads back as the same float.
    return str(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)


class _Line:
    """The columns of a line, and the file and line number for error texts."""

    def __init__(self, where: str, columns: list[str]) -> None:
        if len(columns) != _COLUMNS:
            raise WaypointsError(f"{where}: an item has {_COLUMNS} columns, this line has {len(columns)}")
        self._where = where
        self._columns = columns

    def item(self, seq: int) -> MissionItem:
        found = self._whole(0, "seq", _UINT16)
        if found != seq:
            raise WaypointsError(f"{self._where}: seq must be {seq}, not {found}")
        names = ("param1", "param2", "param3", "param4", "x", "y", "z")
        p1, p2, p3, p4, x, y, z = (self._real(index, name) for index, name in enumerate(names, start=4))
        return MissionItem(
            seq=seq,
            command=self._whole(3, "command", _UINT16),
            params=(p1, p2, p3, p4, x, y, z),
            frame=self._whole(2, "frame", _UINT8),
            current=bool(self._whole(1, "current", 1)),
            autocontinue=bool(self._whole(11, "autocontinue", 1)),
        )

    def _whole(self, index: int, name: str, highest: int) -> int:
        text = self._columns[index]
        try:
            value = int(text)
        except ValueError:
            raise WaypointsError(f"{self._where}: {name} must be a whole number, not {text[:40]!r}") from None
        if not 0 <= value <= highest:
            raise WaypointsError(f"{self._where}: {name} must be 0 to {highest}, not {value}")
        return value

    def _real(self, index: int, name: str) -> float:
        text = self._columns[index]
        try:
            value = float(text)
        except ValueError:
            raise WaypointsError(f"{self._where}: {name} must be a number, not {text[:40]!r}") from None
        if math.isfinite(value) and abs(value) > MAX_NUMBER:
            raise WaypointsError(f"{self._where}: {name} must be at most {MAX_NUMBER:g}, not {text[:40]!r}")
        return value
