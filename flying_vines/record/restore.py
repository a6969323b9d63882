"""Restores the core's events from a log, with exactly the recorded numbers.

A log leaves out NaN and infinities. They are restored as NaN.
"""

from __future__ import annotations

import binascii
import math
from collections.abc import Mapping
from dataclasses import fields
from enum import IntEnum, IntFlag
from functools import cache
from typing import Any, TypeVar, get_args, get_type_hints

from firmware_link import protocol
from flying_vines.core.events import (
    Asked,
    Decision,
    Event,
    Failed,
    FirmwareMessage,
    LinkChanged,
    Said,
    Stop,
    Tick,
    VehicleMessage,
)
from flying_vines.record.reader import FlightLog, LogEntry, LogError
from flying_vines.record.topics import MAVLINK_IN, START, Start, message_in, topic_of
from flying_vines.vehicle.notice import Notice
from flying_vines.vine.intent import Intent, name_of

T = TypeVar("T")
_KINDS: dict[str, type] = {
    topic_of(kind): kind
    for kind in (
        *get_args(protocol.DeviceMessage),
        *(Tick, LinkChanged, Said, Stop, Failed),
        *(Decision, Notice, Start),
    )
}
_INTENTS: dict[str, type] = {name_of(kind): kind for kind in get_args(Intent)}


def start_of(log: FlightLog) -> Start:
    """The state with which the service started. Raises `LogError` if this part is damaged."""
    for entry in log.entries((START,)):
        return restored(Start, entry.fields)
    raise LogError(f"{log.path}: its beginning is damaged")


def event_of(entry: LogEntry) -> Event:
    """The event of an entry from one of the `EVENT_TOPICS`."""
    message = entry.fields
    if entry.topic == MAVLINK_IN:
        return VehicleMessage(message["t"], message_in(binascii.a2b_base64(message["frame"])))
    if entry.topic == topic_of(Asked):
        kind = _INTENTS.get(message["intent"]["kind"])
        if kind is None:
            raise LogError(f"the log has a request of an earlier version, {message['intent']['kind']}")
        intent: Intent = restored(kind, message["intent"])
        return Asked(message["t"], message["by"], intent, message.get("made_at"), message.get("seen_at"))
    event: Any = restored(_KINDS[entry.topic], message)
    if isinstance(event, Tick | LinkChanged | Said | Stop | Failed):
        return event
    return FirmwareMessage(message["t"], event)


def restored(kind: type[T], values: Mapping[str, Any]) -> T:
    """A dataclass from its fields; a missing field becomes NaN (float) or None."""
    return kind(**{
        name: hint(values[name]) if name in values and _is_enum(hint) else values.get(name, unknown)
        for name, (hint, unknown) in _hints(kind).items()  # type: ignore[arg-type]  # mypy: a type is hashable
    })  # fmt: skip


@cache
def _hints(kind: type) -> dict[str, tuple[Any, float | None]]:
    """The type of each field, and the value that it gets if the log has none."""
    hints = get_type_hints(kind)
    names = [field.name for field in fields(kind)]
    return {name: (hints[name], math.nan if hints[name] is float else None) for name in names}


def _is_enum(hint: Any) -> bool:
    return isinstance(hint, type) and issubclass(hint, IntEnum | IntFlag)
