"""A flight for Foxglove and PlotJuggler: the values that their layouts plot, the texts and the position.

Schemas: https://docs.foxglove.dev/docs/sdk/schemas/log and .../location-fix. A layout names topics and
fields, so the export and its layouts belong together.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Any

import msgspec
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.core.events import carried_out_unrequested
from flying_vines.record.mcap_file import McapFile
from flying_vines.record.reader import FlightLog, LogEntry
from flying_vines.record.schema import Schema, obj
from flying_vines.record.topics import DECISION, MAVLINK_IN, NOTICE, SNAPSHOT, TELEMETRY, TOPICS, Topic
from flying_vines.vehicle.notice import Severity

FLIGHT = "viewers.mcap"
LAYOUTS = ("foxglove.json", "plotjuggler.xml")
INFO, WARNING, ERROR = 2, 3, 4
"""Levels of foxglove.Log."""
_POSITION = "GLOBAL_POSITION_INT"
_CHUNK_NS = 1_000_000_000

_NUMBER: Schema = {"type": "number"}
_TIME = obj({"sec": {"type": "integer"}, "nsec": {"type": "integer"}})
_LOG = {
    "timestamp": _TIME,
    "level": {"type": "integer"},
    "message": {"type": "string"},
    "name": {"type": "string"},
}
_FIX = {
    "timestamp": _TIME,
    "frame_id": {"type": "string"},
    **dict.fromkeys(("latitude", "longitude", "altitude"), _NUMBER),
    "position_covariance": {"type": "array", "items": _NUMBER},
    "position_covariance_type": {"type": "integer"},
}
_COPIED = (SNAPSHOT, TELEMETRY)
_TOPICS = (
    *(topic for topic in TOPICS if topic.name in _COPIED),
    Topic("log", "foxglove.Log", obj(_LOG)),
    Topic("location", "foxglove.LocationFix", obj(_FIX)),
)
_NUMBERS = {topic.name: number for number, topic in enumerate(_TOPICS, start=1)}


def export_for_viewers(log: FlightLog, folder: Path) -> list[Path]:
    """Write the flight and the layouts into an existing folder. Returns the paths. Raises `LogError`."""
    paths = [folder / FLIGHT, *(folder / name for name in LAYOUTS)]
    with paths[0].open("wb") as file:
        mcap = McapFile(file, _TOPICS, "flying-vines")
        flushed_ns = 0
        vehicle = ""
        for entry in log.entries((*_COPIED, DECISION, NOTICE, MAVLINK_IN)):
            if entry.unix_ns - flushed_ns > _CHUNK_NS:
                mcap.flush()
                flushed_ns = entry.unix_ns
            if entry.topic == SNAPSHOT:
                vehicle = entry.fields["vehicle"]
            if entry.topic in _COPIED:
                mcap.add(_NUMBERS[entry.topic], entry.unix_ns, entry.data)
            elif message := _fix(entry, vehicle) if entry.topic == MAVLINK_IN else _text(entry):
                name = "location" if entry.topic == MAVLINK_IN else "log"
                mcap.add(_NUMBERS[name], entry.unix_ns, msgspec.json.encode(message))
        mcap.finish()
    templates = resources.files("flying_vines.record").joinpath("templates")
    for path in paths[1:]:
        path.write_bytes(templates.joinpath(path.name).read_bytes())
    return paths


def _text(entry: LogEntry) -> dict[str, Any] | None:
    """A decision or notice as foxglove.Log. A notice that repeats a decision is left out."""
    said = entry.fields
    if entry.topic == NOTICE:
        if said["of_decision"] or said["severity"] == Severity.DEBUG:
            return None
        levels = {Severity.ERROR: ERROR, Severity.WARNING: WARNING}
        return _log(entry, levels.get(said["severity"], INFO), said["text"], "notice")
    text = f"{said.get('intent', '?')}: {said['safety']}" + (f" ({said['reason']})" if said["reason"] else "")
    unrequested = carried_out_unrequested(said["trigger"], said["safety"])
    level = INFO if said["safety"] == "accepted" and not unrequested else WARNING
    return _log(entry, level, text, said["trigger"])


def _log(entry: LogEntry, level: int, message: str, name: str) -> dict[str, Any]:
    return {"timestamp": _time(entry), "level": level, "message": message, "name": name}


def _fix(entry: LogEntry, vehicle: str) -> dict[str, Any] | None:
    """The autopilot's position as foxglove.LocationFix; its accuracy is not known.

    `vehicle`: as in the latest snapshot. It ends with the system id.
    """
    message = entry.fields
    at = message.get(_POSITION)
    if at is None or not (at["lat"] or at["lon"]):
        return None
    is_autopilot = message["component_id"] == mavlink.MAV_COMP_ID_AUTOPILOT1
    if not is_autopilot or vehicle.split()[-1:] != [str(message["system_id"])]:
        return None
    return {
        "timestamp": _time(entry),
        "frame_id": "earth",
        "latitude": at["lat"] / 1e7,
        "longitude": at["lon"] / 1e7,
        "altitude": at["alt"] / 1e3,
        "position_covariance": [0.0] * 9,
        "position_covariance_type": 0,
    }


def _time(entry: LogEntry) -> dict[str, int]:
    return {"sec": entry.unix_ns // 10**9, "nsec": entry.unix_ns % 10**9}
