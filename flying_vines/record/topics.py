"""The topics of a flight's log, and the conversion of events and actions to messages.

Pressures are gauge kPa, times `t` seconds of the service's monotonic clock. Unknown values are left out. A
MAVLink message is logged as its whole frame. The fields of the types in `DECODED` are logged, too, under the
type's name.
"""

from __future__ import annotations

import binascii
import re
from dataclasses import dataclass, field
from typing import Any, NamedTuple, get_args

import msgspec
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from firmware_link import protocol
from flying_vines.core.events import (
    Action,
    Asked,
    Decision,
    Event,
    Failed,
    FirmwareMessage,
    InternalError,
    KeepBoardSettings,
    KeepDisarmed,
    KeepLatched,
    KeepLearned,
    KeepParameters,
    LinkChanged,
    Measured,
    Said,
    Stop,
    Tick,
    ToFirmware,
    ToVehicle,
    VehicleMessage,
)
from flying_vines.core.snapshot import Snapshot
from flying_vines.record.schema import Schema, merged, obj, of_dataclass, of_mavlink, of_type
from flying_vines.vehicle.mavlink import handled_messages as handled
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.mavlink.frames import Frame, Frames, frame_in
from flying_vines.vehicle.mavlink.payloads import message_of
from flying_vines.vehicle.notice import Notice
from flying_vines.vine.intent import Intent, name_of

_NEXT_FRAME = bytes((mavlink.PROTOCOL_MARKER_V2,))
_encode = msgspec.json.Encoder().encode
_decode = msgspec.json.Decoder().decode

DECODED = handled.ALL | {"NAMED_VALUE_FLOAT"}
"""MAVLink messages whose fields are logged in addition to their frames."""


@dataclass(frozen=True, slots=True)
class Start:
    """The start state of the core. With the events after it, a replay gives the same decisions."""

    t: float
    profile: str
    """The configuration's text."""
    rig: str
    """The rig file's text; empty if there was none."""
    parameters: dict[str, float]
    """Saved parameters of the pilot."""
    disarmed: bool
    """The pneumatics were disarmed when the previous run of the service ended."""
    learned: str
    """What the previous run learned about the rig's air, as stored on disk; or empty."""
    believed: dict[str, Any]
    """The rig of `[pneumatics]`, as tables of a rig file."""
    continues: str
    """The previous folder of this run of the service; empty in its first folder."""
    latched: dict[str, str] = field(default_factory=dict)
    """The faults of the previous run that nobody has cleared, by name."""
    board_settings: int | None = None
    """The digest of the board's settings that the previous run knew."""


@dataclass(frozen=True, slots=True)
class Mavlink:
    """A MAVLink message: its frame and, if this project uses the type, its fields under the type's name."""

    t: float
    name: str
    system_id: int
    component_id: int
    frame: str
    """Base64."""


class Topic(NamedTuple):
    """A channel of the log. Its number is its position in `TOPICS`, counted from 1."""

    name: str
    schema_name: str
    schema: Schema


def _snake(name: str) -> str:
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()


def _topic(name: str, kind: type, with_t: bool = False) -> Topic:
    schema = of_dataclass(kind)
    if with_t:
        schema["properties"] = {"t": of_type(float), **schema["properties"]}
    return Topic(name, f"flying_vines.{kind.__name__}", schema)


def _mavlink_topic(name: str) -> Topic:
    schema = of_dataclass(Mavlink)
    schema["properties"]["frame"]["contentEncoding"] = "base64"
    for kind in sorted(mavlink.mavlink_map.values(), key=lambda kind: str(kind.msgname)):
        if kind.msgname in DECODED:
            schema["properties"][kind.msgname] = of_mavlink(kind)
    return Topic(name, "flying_vines.Mavlink", schema)


_SERIAL: dict[type, str] = {
    kind: f"phlosar/{_snake(kind.__name__)}"
    for kind in (*get_args(protocol.HostMessage), *get_args(protocol.DeviceMessage))
}
_EVENTS: dict[type, str] = {
    Tick: "tick",
    LinkChanged: "link",
    Said: "said",
    Asked: "asked",
    Stop: "stop",
    Failed: "failed",
}
_ANSWERS: dict[type, str] = {
    Decision: "decision",
    Notice: "notice",
    KeepParameters: "parameters",
    KeepDisarmed: "disarmed",
}
_STATES: dict[type, str] = {
    Start: "start",
    Snapshot: "snapshot",
    InternalError: "internal_error",
    KeepLearned: "learned",
    KeepLatched: "latched",
    KeepBoardSettings: "board_settings",
}
"""Entries that are neither inputs of the core nor outputs that a replay compares."""
MAVLINK_IN, MAVLINK_OUT = "mavlink/in", "mavlink/out"


def _asked_schema() -> Schema:
    wanted = merged(of_dataclass(kind) for kind in get_args(Intent))
    wanted["properties"] = {"kind": of_type(str), **wanted["properties"]}
    times = {name: of_type(float) for name in ("made_at", "seen_at")}
    return obj({"t": of_type(float), "by": of_type(str), "intent": wanted, **times}, Asked.__doc__ or "")


def _topics() -> tuple[Topic, ...]:
    plain = {**_STATES, **_EVENTS, **_ANSWERS}
    return (
        _mavlink_topic(MAVLINK_IN),
        _mavlink_topic(MAVLINK_OUT),
        *(_topic(name, kind, with_t=True) for kind, name in _SERIAL.items()),
        *(
            Topic(name, "flying_vines.Asked", _asked_schema()) if kind is Asked else _topic(name, kind)
            for kind, name in plain.items()
        ),
    )


TOPICS = _topics()
NUMBERS = {topic.name: number for number, topic in enumerate(TOPICS, start=1)}
EVENT_TOPICS = frozenset({
    MAVLINK_IN, *_EVENTS.values(),
    *(_SERIAL[kind] for kind in get_args(protocol.DeviceMessage)),
})  # fmt: skip
"""Inputs of the core."""
ANSWER_TOPICS = frozenset({
    MAVLINK_OUT, *_ANSWERS.values(),
    *(_SERIAL[kind] for kind in get_args(protocol.HostMessage)),
})  # fmt: skip
"""Outputs of the core that a replay compares."""
START, SNAPSHOT = _STATES[Start], _STATES[Snapshot]
DECISION, NOTICE = _ANSWERS[Decision], _ANSWERS[Notice]
TELEMETRY = _SERIAL[protocol.Telemetry]

RawEntry = tuple[int, float, Any]
"""A topic's number, the time, and the content: a dataclass, or a MAVLink frame."""

_IN, _OUT = NUMBERS[MAVLINK_IN], NUMBERS[MAVLINK_OUT]
_NUMBER_OF = {kind: NUMBERS[name] for kind, name in (_SERIAL | _EVENTS | _ANSWERS | _STATES).items()}


def topic_of(kind: type) -> str:
    return TOPICS[_NUMBER_OF[kind] - 1].name


def entry_of_event(event: Event) -> RawEntry:
    """The entry for an event. This runs in the service's loop, so it does not encode."""
    if isinstance(event, VehicleMessage):
        return _IN, event.t, event.message.get_msgbuf()
    if isinstance(event, FirmwareMessage):
        return _NUMBER_OF[type(event.message)], event.t, event.message
    return _NUMBER_OF[type(event)], event.t, event


def entry_of_action(t: float, action: Action) -> RawEntry | None:
    """`t` is the time of the event that caused the action. None: the action only repeats an event."""
    if isinstance(action, ToVehicle):
        return _OUT, t, action.message.get_msgbuf()
    if isinstance(action, ToFirmware):
        return _NUMBER_OF[type(action.message)], t, action.message
    if isinstance(action, Measured):
        return None
    return _NUMBER_OF[type(action)], action.t, action


def entry_of_state(state: Snapshot | Start) -> RawEntry:
    return _NUMBER_OF[type(state)], state.t, state


def encoded(entry: RawEntry) -> bytes:
    number, t, content = entry
    if number in (_IN, _OUT):
        return _mavlink(t, bytes(content))
    if isinstance(content, Asked):
        return _without_nulls(_encode(_with_kind(content)))
    data = _encode(content)
    if not hasattr(content, "t"):
        rest = data[1:]
        data = b'{"t":' + _encode(t) + (b"" if rest == b"}" else b",") + rest
    return _without_nulls(data)


def _with_kind(asked: Asked) -> dict[str, Any]:
    """The fields of a request and the name of its intent's type."""
    plain: dict[str, Any] = msgspec.to_builtins(asked)
    plain["intent"] = {"kind": name_of(type(asked.intent)), **plain["intent"]}
    return plain


def _without_nulls(data: bytes) -> bytes:
    if b":null" not in data:
        return data
    return _encode(_known(_decode(data)))


def _known(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _known(item) for key, item in value.items() if item is not None}
    return value


def _mavlink(t: float, raw: bytes) -> bytes:
    frame = frame_in(raw)
    entry: dict[str, Any] = {
        "t": t,
        "name": f"UNKNOWN_{frame.message_id}",
        "system_id": frame.system,
        "component_id": frame.component,
        "frame": binascii.b2a_base64(raw, newline=False).decode("ascii"),
    }
    if frame.known:
        name = entry["name"] = mavlink.mavlink_map[frame.message_id].msgname
        if name in DECODED:
            message = message_of(frame)
            entry[name] = {field: getattr(message, field) for field in message.fieldnames}
    return _without_nulls(_encode(entry))


def frame_of(raw: bytes) -> Frame:
    """The frame in `raw`, which was valid when it was received or sent."""
    # `Frames` returns a frame of an unknown type only if another frame follows.
    (frame,) = Frames().take(raw + _NEXT_FRAME)
    return frame


def message_in(raw: bytes) -> MavlinkMessage:
    return message_of(frame_of(raw))
