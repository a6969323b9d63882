"""A flight for others: CSV tables, one a topic, units in the headings; or a zip file for a bug report."""

from __future__ import annotations

import csv
import json
import shutil
import time
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec

from flying_vines.record.flight_metadata import ABOUT, FlightMetadata
from flying_vines.record.folders import CONFIGURATION, MCAP, RIG, TLOG
from flying_vines.record.reader import FlightLog
from flying_vines.record.schema import Schema
from flying_vines.record.topics import MAVLINK_IN, MAVLINK_OUT, TOPICS

_SCHEMAS = {topic.name: topic.schema for topic in TOPICS}
PARTS = (MCAP, TLOG, CONFIGURATION, RIG, ABOUT)
"""Only these files, because a person may have put anything else into the folder."""


class _Table:
    def __init__(self, path: Path, schema: Schema, opened: ExitStack) -> None:
        columns = dict(_columns(schema))
        self._keys = list(columns)
        file = opened.enter_context(path.open("w", encoding="utf-8", newline=""))
        self._writer = csv.writer(file)
        self._writer.writerow(["unix_s", *columns.values()])

    def write(self, unix_ns: int, message: Mapping[str, Any]) -> None:
        cells = [_cell(message, key) for key in self._keys]
        self._writer.writerow([f"{unix_ns // 10**9}.{unix_ns % 10**9:09}", *cells])


def export_csv(log: FlightLog, folder: Path) -> list[Path]:
    """Write the tables into an existing folder and return their paths.

    MAVLink has one table per message type and direction. Raises `LogError`.
    """
    tables: dict[str, _Table] = {}
    paths = []
    with ExitStack() as opened:
        for entry in log.entries():
            message = entry.fields
            schema = _SCHEMAS.get(entry.topic, {"properties": {"t": {}}})
            name = entry.topic
            if entry.topic in (MAVLINK_IN, MAVLINK_OUT):
                name = f"{name}/{message['name']}"
                schema = _of_one_kind(schema, message["name"])
            if name not in tables:
                path = folder / f"{name.replace('/', '_')}.csv"
                tables[name] = _Table(path, schema, opened)
                paths.append(path)
            tables[name].write(entry.unix_ns, message)
    return sorted(paths)


def _of_one_kind(schema: Schema, kind: str) -> Schema:
    """A MAVLink topic's schema, without the fields of other message types."""
    properties = {
        name: inner
        for name, inner in schema["properties"].items()
        if inner.get("type") != "object" or name == kind
    }
    return {**schema, "properties": properties}


def _columns(schema: Schema, within: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], str]]:
    """The path to each value, and the name of its column."""
    for name, inner in schema["properties"].items():
        path = (*within, name)
        if inner.get("properties"):
            yield from _columns(inner, path)
            continue
        column = ".".join(path)
        if path == ("t",):
            column = "t_s"
        elif unit := inner.get("description", ""):
            column += f" [{unit}]"
        yield path, column


def _cell(message: Mapping[str, Any], path: tuple[str, ...]) -> object:
    value: Any = message
    for name in path:
        value = value.get(name) if isinstance(value, Mapping) else None
    return json.dumps(value, ensure_ascii=False) if isinstance(value, dict | list) else value


def bundle(log: FlightLog, events: str, path: Path) -> list[str]:
    """Write a zip file about the flight and this machine. Returns the names in it.

    `events` is the flight as text, as `log show` prints it.
    """
    names = []
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name in PARTS:
            part = log.folder / name
            if part.is_file():
                file.write(part, f"{log.folder.name}/{name}")
                names.append(name)
        for name, text in (("story.txt", events), ("this-machine.json", _this_machine(log.folder))):
            file.writestr(f"{log.folder.name}/{name}", text)
            names.append(name)
    return names


def _this_machine(folder: Path) -> str:
    """The machine that made the bundle. The flight may have been recorded on another."""
    disk = shutil.disk_usage(folder)
    facts = {
        **msgspec.to_builtins(FlightMetadata.of_this_machine(0, time.time(), "")),
        "disk_free_MB": round(disk.free / 1e6),
        "disk_total_MB": round(disk.total / 1e6),
    }
    del facts["number"], facts["continues"], facts["firmware"]
    return msgspec.json.format(msgspec.json.encode(facts), indent=2).decode() + "\n"
