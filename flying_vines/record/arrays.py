"""Flights and MAVLink telemetry logs as numpy arrays: one table for each topic or message type.

`pandas.DataFrame(table)` makes a data frame of a table whose columns are one-dimensional.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flying_vines.record.reader import FlightLog, LogError
from flying_vines.record.topics import MAVLINK_IN, MAVLINK_OUT

Table = dict[str, NDArray[Any]]
"""(n,) or (n, k) for each column. `unix_s` is the time; units are those of the log."""


def read_flight(path: Path | str) -> dict[str, Table]:
    """The tables of a recorded flight, by topic.

    Args:
        path: `flight.mcap`, its folder, or `last` in a folder of flights.

    Returns: tables with `unix_s`, and a column for each field, named as in the log. Nested fields are
    `outer.inner`. MAVLink messages are in `mavlink/in/NAME` and `mavlink/out/NAME`. A missing value is NaN,
    or None in a column that is not numeric.

    Raises LogError if there is nothing to read.
    """
    rows: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for entry in FlightLog(Path(path)).entries():
        fields = entry.fields
        name = entry.topic
        if name in (MAVLINK_IN, MAVLINK_OUT):
            name = f"{name}/{fields['name']}"
        rows[name].append({"unix_s": entry.unix_ns / 1e9, **_flat(fields)})
    return {name: _table(entries) for name, entries in rows.items()}


def read_tlog(path: Path | str) -> dict[str, Table]:
    """The tables of a .tlog of a ground station, by MAVLink message type.

    Returns: tables with `unix_s`, `system` and `component` of the sender, and a column for each field, in the
    unit of the MAVLink definition.

    Raises LogError if the file cannot be read or has no message.
    """
    from pymavlink import mavutil

    path = Path(path)
    if not path.is_file():
        raise LogError(f"{path}: no such file")
    rows: dict[str, list[dict[str, Any]]] = defaultdict(list)
    log = mavutil.mavlink_connection(str(path), dialect="ardupilotmega")
    try:
        while (message := log.recv_msg()) is not None:
            kind = message.get_type()
            if kind != "BAD_DATA":
                fields = {key: value for key, value in message.to_dict().items() if key != "mavpackettype"}
                sender = {"system": message.get_srcSystem(), "component": message.get_srcComponent()}
                rows[kind].append({"unix_s": message._timestamp, **sender, **fields})
    finally:
        log.close()
    if not rows:
        raise LogError(f"{path}: has no MAVLink message")
    return {name: _table(entries) for name, entries in rows.items()}


def _flat(fields: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in fields.items():
        if isinstance(value, Mapping):
            flat.update(_flat(value, f"{prefix}{name}."))
        else:
            flat[prefix + name] = value
    return flat


def _table(rows: list[dict[str, Any]]) -> Table:
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: _column([row.get(name) for row in rows]) for name in names}


def _column(values: list[Any]) -> NDArray[Any]:
    """(n,) of numbers, (n, k) of lists of k numbers, otherwise (n,) of objects."""
    known = [value for value in values if value is not None]
    if known and all(isinstance(value, int | float) for value in known):
        return np.array([np.nan if v is None else v for v in values])
    lengths = {len(value) if isinstance(value, list) else -1 for value in values}
    if len(lengths) == 1 and -1 not in lengths and all(isinstance(v, int | float) for x in values for v in x):
        return np.array(values)
    column = np.empty(len(values), dtype=object)
    column[:] = values
    return column
