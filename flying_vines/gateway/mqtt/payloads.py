"""What is in each message on the broker. Pressures are gauge kPa, angles degrees; null is unknown.

`SCHEMA_VERSION` goes up when something that is there changes or goes; what is added does not count.
So whoever reads it ignores what is new to him.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from flying_vines.vine.intent import CommandName

SCHEMA_VERSION = 1
LONGEST_ID = 64

RulingName = Literal["accepted", "limited", "refused"]
SeverityName = Literal["error", "warning", "notice", "info"]


class _Told(msgspec.Struct, frozen=True, kw_only=True):
    version: int = SCHEMA_VERSION
    unix_s: float
    """By the vehicle's clock."""


class StatusPayload(_Told, frozen=True, kw_only=True):
    """Whether anybody is there: retained. The last will says `offline`, with the time of its connecting."""

    status: Literal["online", "silent", "offline"]
    """`silent`: the computer is there, the service that flies does not speak."""


class LimitsPayload(msgspec.Struct, frozen=True):
    """As the profile has them; a pilot's parameters may be tighter."""

    max_kPa: float
    max_bend_deg: float
    max_rate_kPa_per_s: float
    max_bent_s: float
    overpressure_kPa: float


class AboutPayload(_Told, frozen=True, kw_only=True):
    """What this vehicle is: retained."""

    name: str
    flying_vines: str
    """The version of the software."""
    run: str
    """Of this start of the sender; events are numbered anew in each."""
    profiles: tuple[str, ...]
    limits: LimitsPayload
    commands: tuple[CommandName, ...]
    """What may be asked for."""
    asked_within_s: float
    rate_Hz: float


class StatePayload(_Told, frozen=True, kw_only=True):
    """How things stand."""

    t: float
    """By a clock that nobody sets, in seconds; for the `seen_at` of an ask."""
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
    """In the vine."""
    command_kPa: float | None
    bend_deg: float | None
    doing: str
    safe_state: dict[str, str]
    """Why the vine may not bend, each with a sentence; empty when it may."""
    pneumatics_armed: bool
    bench: bool


class CyclesPayload(msgspec.Struct, frozen=True):
    """How often the vine can still be bent: a prediction, and the interval that holds nine times of ten."""

    expected: float
    low: float
    high: float
    measured_cycles: float
    """Flown so far, that the cost was measured on."""
    cost_kPa: float


class ReservoirPayload(_Told, frozen=True, kw_only=True):
    """The bottle."""

    reservoir_kPa: float | None
    cycles: CyclesPayload | None


class _Event(_Told, frozen=True, kw_only=True, tag_field="event"):
    run: str
    number: int
    """From 1 on in each run. One that comes twice has the same number."""


class DecisionEvent(_Event, frozen=True, kw_only=True, tag="decision"):
    """Somebody or something wanted the vine to move, and what came of it."""

    trigger: str
    what: dict[str, Any]
    intent: str | None
    safety: RulingName
    reason: str
    setpoint_kPa: float | None


class NoticeEvent(_Event, frozen=True, kw_only=True, tag="notice"):
    """A sentence for people. `of_decision`: a decision of the same moment says the same."""

    severity: SeverityName
    text: str
    of_decision: bool


class LostEvent(_Event, frozen=True, kw_only=True, tag="lost"):
    """So many events before the next were not kept while the broker was away; the last one's number."""

    count: int


EventPayload = DecisionEvent | NoticeEvent | LostEvent


class RequestPayload(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A person wants something."""

    version: Literal[1] = 1
    id: Annotated[str, Meta(min_length=1, max_length=LONGEST_ID)]
    """Never used before; the answer has it, too."""
    unix_s: float
    """When it was asked."""
    command: CommandName
    value: float | None = None
    """Of `bend` an angle, of `pressure` a pressure."""
    name: str | None = None
    """Of `profile`."""
    seen_at: float | None = None
    """The `t` of the latest `state` that was seen: no fault that came later is cleared."""

    def __post_init__(self) -> None:
        if not math.isfinite(self.unix_s):
            raise ValueError("unix_s is not a finite number")


class AnswerPayload(_Told, frozen=True, kw_only=True):
    """What came of an `RequestPayload`."""

    id: str | None
    """Null where what was asked could not be read."""
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
"""By the last word of the topic."""


def schemas() -> dict[str, Any]:
    """JSON Schema (2020-12) of what is in each topic."""
    refs, components = msgspec.json.schema_components(PAYLOADS.values(), ref_template="#/$defs/{name}")
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Flying Vines over MQTT",
        "topics": dict(zip(PAYLOADS, refs, strict=True)),
        "$defs": components,
    }
