"""The topics of one vehicle, and the messages on them.

Pressures are gauge kPa, angles degrees; null is unknown.

`SCHEMA_VERSION` increases when a field changes or disappears. New fields do not change it, so readers must
ignore unknown fields.
"""

from __future__ import annotations

import math
import re
import socket
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from flying_vines.config.config import MqttConfig
from flying_vines.vine.intent import CommandName

SCHEMA_VERSION = 1
MAX_ID_LENGTH = 64
ASKED_WITHIN_S = 5.0
"""Maximum age of a request that only deflates the vine; of all others: `ACTS_WITHIN_S`."""

RulingName = Literal["accepted", "limited", "refused"]
SeverityName = Literal["error", "warning", "notice", "info"]


class Topics:
    """The topics of one vehicle; all begin with `base`.

    The vehicle's name in the topic separates the vehicles of a fleet.
    """

    def __init__(self, prefix: str, name: str) -> None:
        self.prefix, self.name = prefix, name
        self.base = base = f"{prefix}/{name}"
        self.status = f"{base}/status"
        self.about = f"{base}/about"
        self.state = f"{base}/state"
        self.reservoir = f"{base}/reservoir"
        self.event = f"{base}/event"
        self.ask = f"{base}/ask"
        self.answer = f"{base}/answer"

    @classmethod
    def of(cls, mqtt: MqttConfig) -> Topics:
        """A vehicle without a name has the computer's name."""
        return cls(mqtt.prefix, mqtt.name or re.sub(r"[^\w.-]", "-", socket.gethostname(), flags=re.ASCII))


class _Payload(msgspec.Struct, frozen=True, kw_only=True):
    version: int = SCHEMA_VERSION
    unix_s: float
    """Time by the vehicle's clock."""


class StatusPayload(_Payload, frozen=True, kw_only=True):
    """Retained. The last will is `offline`, with the time of the connection."""

    status: Literal["online", "silent", "offline"]
    """`silent`: the computer is connected, but the service sends nothing."""


class LimitsPayload(msgspec.Struct, frozen=True):
    """The configured limits. The pilot may have set lower ones."""

    max_kPa: float
    max_bend_deg: float
    max_rate_kPa_per_s: float
    max_bent_s: float
    overpressure_kPa: float


class AboutPayload(_Payload, frozen=True, kw_only=True):
    """Describes this vehicle. Retained."""

    name: str
    flying_vines: str
    """The version of the software."""
    run: str
    """Id of this run of the sender. Each run numbers its events from 1."""
    profiles: tuple[str, ...]
    limits: LimitsPayload
    commands: tuple[CommandName, ...]
    """The permitted requests."""
    asked_within_s: float
    rate_Hz: float


class WaitingPayload(msgspec.Struct, frozen=True):
    """Somebody asks for a bend, and nothing moves until a fresh request."""

    stopped_by: str
    """What vented the vine, or why the bend was refused."""
    awaited: str
    """The request that would move the vine, such as "switch down, then up"."""


class StatePayload(_Payload, frozen=True, kw_only=True):
    """The present state."""

    t: float
    """Time on a monotonic clock, seconds; for `seen_at` of a request."""
    vehicle: str
    mode: str
    armed: bool
    altitude_m: float | None
    """Above home."""
    rc: str
    switch_position: int | None
    firmware: str
    reservoir_kPa: float | None
    cv_kPa: float | None
    """Pressure in the vine."""
    command_kPa: float | None
    bend_deg: float | None
    doing: str
    safe_state: dict[str, str]
    """Reasons why the vine may not bend, each with a sentence; empty if it may."""
    unstable: dict[str, str] = {}
    """What comes and goes, such as "RC", each with a sentence."""
    pneumatics_armed: bool
    bench: bool
    waiting: WaitingPayload | None = None
    """Null while nobody asks for a bend, and while a motion runs."""


class CyclesPayload(msgspec.Struct, frozen=True):
    """Cycles left: prediction and 90 % interval."""

    expected: float
    low: float
    high: float
    measured_cycles: float
    """Number of flown cycles from which the cost was measured."""
    cost_kPa: float
    bend_kPa: float
    """Swing of the last bend."""
    per_cycle: float
    """Number of bends like the last one that take the air of one cycle."""
    minutes: float
    """Time that the air lasts without another bend, at the present loss; 600 means 600 or more."""
    minutes_low: float
    minutes_high: float
    lost: bool
    """Air is lost: nothing is left until a person clears the fault."""


class ReservoirPayload(_Payload, frozen=True, kw_only=True):
    """The reservoir."""

    reservoir_kPa: float | None
    cycles: CyclesPayload | None


class _Event(_Payload, frozen=True, kw_only=True, tag_field="event"):
    run: str
    number: int
    """Counts from 1 in each run. A repeated event has the same number."""


class DecisionEvent(_Event, frozen=True, kw_only=True, tag="decision"):
    """A request or trigger to move the vine, and its result."""

    trigger: str
    what: dict[str, Any]
    intent: str | None
    safety: RulingName
    reason: str
    setpoint_kPa: float | None


class NoticeEvent(_Event, frozen=True, kw_only=True, tag="notice"):
    """A sentence for people. `of_decision`: a decision of the same moment has the same text."""

    severity: SeverityName
    text: str
    of_decision: bool


class LostEvent(_Event, frozen=True, kw_only=True, tag="lost"):
    """`count` events were lost while the broker was away. `number`: of the last lost event."""

    count: int


EventPayload = DecisionEvent | NoticeEvent | LostEvent


class RequestPayload(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A person's request."""

    version: Literal[1] = 1
    id: Annotated[str, Meta(min_length=1, max_length=MAX_ID_LENGTH)]
    """Must be new. The answer has the same id."""
    unix_s: float
    """Time of the request."""
    command: CommandName
    value: float | None = None
    """The angle of `bend`, or the pressure of `pressure`."""
    name: str | None = None
    """The name of `profile`."""
    seen_at: float | None = None
    """The `t` of the latest `state` that the person saw: newer faults are not cleared."""

    def __post_init__(self) -> None:
        if not math.isfinite(self.unix_s):
            raise ValueError("unix_s is not a finite number")


class AnswerPayload(_Payload, frozen=True, kw_only=True):
    """The result of a `RequestPayload`."""

    id: str | None
    """Null if the request could not be read."""
    safety: Literal["accepted", "limited", "refused", "unknown"]
    """`unknown`: the service did not answer."""
    reason: str


PAYLOADS: dict[str, Any] = {
    "status": StatusPayload,
    "about": AboutPayload,
    "state": StatePayload,
    "reservoir": ReservoirPayload,
    "event": EventPayload,
    "ask": RequestPayload,
    "answer": AnswerPayload,
}
"""The payloads, by the last level of the topic."""


def schemas() -> dict[str, Any]:
    """JSON Schema (2020-12) of the messages of each topic."""
    refs, components = msgspec.json.schema_components(PAYLOADS.values(), ref_template="#/$defs/{name}")
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Flying Vines over MQTT",
        "topics": dict(zip(PAYLOADS, refs, strict=True)),
        "$defs": components,
    }
