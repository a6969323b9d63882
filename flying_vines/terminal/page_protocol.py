"""Converts the page's messages to snapshots, decisions and notices."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any, Literal, NamedTuple, TypeVar

import msgspec

from flying_vines.core.events import Decision
from flying_vines.core.snapshot import Snapshot
from flying_vines.vehicle.notice import Notice

VENT_AGAIN_S = 0.5
LATE_S = 2.0
"""A message comes at least once a second. After this time without one, the link counts as lost."""

_ACTIONS: dict[str, type[Decision] | type[Notice]] = {"decision": Decision, "notice": Notice}
_NUMBERS = [field.name for field in fields(Snapshot) if field.type == "float"]


class VineScale(NamedTuple):
    """The pressures at which the bars are full, gauge kPa."""

    max_kPa: float
    full_kPa: float


_Found = TypeVar("_Found")


class InvalidMessageError(Exception):
    """The message is not valid for a page of this version."""


class _Answer(msgspec.Struct):
    """The page's answer to request `id`."""

    id: int
    safety: Literal["accepted", "limited", "refused", "unanswered"]
    reason: str


class PageDecoder:
    """Decodes the messages of a service's page. After a link loss no event is returned twice.

    `t` is a time on our clock; events and snapshots have times on the service's clock.
    """

    def __init__(self) -> None:
        self.vine: VineScale | None = None
        self.began = 0.0
        """The service's time of the first known event."""
        self.snapshot: Snapshot | None = None
        self._shown_at = -math.inf
        self._latest_t = -math.inf

    def take(self, t: float, text: str) -> list[Decision | Notice]:
        """Take in a message at `t`; returns the new events. Raises `InvalidMessageError`."""
        return _decoded(text, lambda message: self._take(t, message))

    def _take(self, t: float, message: Any) -> list[Decision | Notice]:
        match message["kind"]:
            case "hello":
                return self._welcome(message)
            case "snapshot":
                self.snapshot = _snapshot(message["snapshot"])
                self._shown_at = t
            case "happened":
                return self._note(_actions([message]))
        return []

    def _welcome(self, hello: dict[str, Any]) -> list[Decision | Notice]:
        """A hello contains past events. Only events from the time without a link are new."""
        past = _actions(hello["happened"])
        if self.vine is None or hello["t"] < self._latest_t:
            # The first hello, or the hello of a restarted service.
            self.began = min([hello["t"], *(action.t for action in past)])
            self._latest_t = -math.inf
        self.vine = VineScale(hello["vine"]["max_kPa"], hello["vine"]["full_kPa"])
        return self._note([action for action in past if action.t > self._latest_t])

    def _note(self, news: list[Decision | Notice]) -> list[Decision | Notice]:
        self._latest_t = max([self._latest_t, *(action.t for action in news)])
        return news

    def snapshot_age_s(self, t: float) -> float:
        return t - self._shown_at


class VentRequest:
    """A vent request. It is repeated until it is confirmed or refused, also after a link loss."""

    def __init__(self) -> None:
        self.pressed_at: float | None = None
        self._seen_at: float | None = None
        self._sent_at = -math.inf
        self._number = 0
        self._first_number = 1
        """The number of the first request of the latest press."""

    def press(self, t: float, seen: Snapshot | None) -> None:
        """`seen`: the snapshot on the screen; newer faults are not cleared."""
        self.pressed_at = t
        self._seen_at = seen.t if seen else None
        self._sent_at = -math.inf
        self._first_number = self._number + 1

    def pop_message(self, t: float) -> str | None:
        """The message to send at time `t`, or None. A returned message counts as sent."""
        if self.pressed_at is None or t - self._sent_at < VENT_AGAIN_S:
            return None
        self._sent_at = t
        self._number += 1
        request = {"id": self._number, "command": "vent", "seen_at": self._seen_at}
        return msgspec.json.encode(request).decode()

    def take(self, t: float, text: str) -> str | None:
        """The page's answer to the request as a sentence; None for other messages.

        Raises `InvalidMessageError`. An answer to an earlier press is no answer to this one.
        """
        answer = _decoded(text, _answer)
        if self.pressed_at is None or answer is None or answer.safety == "unanswered":
            return None
        if not self._first_number <= answer.id <= self._number:
            return None
        after_s = t - self.pressed_at
        self.pressed_at = None
        if answer.safety == "refused":
            return f"VENT refused: {answer.reason}"
        if answer.reason:
            return f"VENT sent, {answer.reason}"
        return f"VENT confirmed after {after_s:.2f} s"


def _decoded(text: str, read: Callable[[Any], _Found]) -> _Found:
    """What `read` finds in a message. Raises `InvalidMessageError`."""
    try:
        return read(msgspec.json.decode(text))
    except (msgspec.DecodeError, LookupError, TypeError, ValueError) as error:
        raise InvalidMessageError(f"invalid message from the page: {error}") from None


def _answer(message: Any) -> _Answer | None:
    return msgspec.convert(message, _Answer) if message["kind"] == "answer" else None


def _actions(happened: Sequence[dict[str, Any]]) -> list[Decision | Notice]:
    return [
        msgspec.convert(each["fields"], _ACTIONS[each["what"]])
        for each in happened
        if each["what"] in _ACTIONS
    ]


def _snapshot(shown: dict[str, Any]) -> Snapshot:
    """The snapshot; null becomes NaN."""
    known = {name: math.nan if shown.get(name) is None else shown[name] for name in _NUMBERS}
    return msgspec.convert({**shown, **known}, Snapshot)
