"""Checks that requests from the broker are permitted, recent and not repeated. Reads no clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from itertools import islice, takewhile
from typing import NamedTuple

import msgspec

from flying_vines.gateway import messages
from flying_vines.gateway.mqtt.payloads import ASKED_WITHIN_S, AnswerPayload, RequestPayload
from flying_vines.gateway.mqtt.publisher import Now
from flying_vines.vehicle.token_bucket import TokenBucket
from flying_vines.vine.intent import CommandName

MAX_REQUEST_LENGTH = 1024
MAX_AT_ONCE, MAX_PER_S = 10.0, 5.0
"""Above this rate, vents are carried out, and all other requests are ignored without an answer."""
MAX_WAITING = 20
MAX_STORED_IDS = 2000
_VENT = b'"vent"'
_DECODER = msgspec.json.Decoder(RequestPayload)


class QueuedRequest(NamedTuple):
    """A request for the service, and its time on the monotonic clock."""

    request: RequestPayload
    made_at: float


class RequestQueue:
    """Checks incoming requests, and returns those for the service, one after another."""

    def __init__(self, commands: Sequence[CommandName]) -> None:
        self._commands = commands
        self._known: dict[str, float] = {}
        """Request times, by id."""
        self._waiting: deque[QueuedRequest] = deque()
        self._bucket = TokenBucket(0.0, MAX_AT_ONCE, MAX_PER_S)
        self.ignored = 0

    def receive(self, now: Now, payload: bytes, retained: bool) -> list[AnswerPayload]:
        """Handles one message. Returns the answers that can be sent at once."""
        # In a flood most messages are not even parsed.
        may_be_vent = self._may_be_vent(payload)
        if not may_be_vent and not self._bucket.take(now.t):
            self.ignored += 1
            return []
        request, problem = self._read(now, payload, retained)
        if request is not None and not problem and request.command == "vent":
            return self._vent(now, request)
        if may_be_vent and not self._bucket.take(now.t):
            self.ignored += 1
            return []
        if request is None or problem:
            return [refused(now, request, problem)]
        if len(self._waiting) >= MAX_WAITING:
            return [refused(now, request, "too many requests at once")]
        self._waiting.append(QueuedRequest(request, made_at(now, request)))
        return []

    @property
    def waits(self) -> bool:
        """True if a request waits for the service."""
        return bool(self._waiting)

    def next(self) -> list[QueuedRequest]:
        """The requests to send to the service now: all waiting vents as one, or the first other request."""
        vents = list(takewhile(lambda each: each.request.command == "vent", self._waiting))
        together = vents or list(islice(self._waiting, 1))
        for _ in together:
            self._waiting.popleft()
        return together

    def disconnected(self) -> None:
        """Drop waiting requests: they must not move the vine when the broker returns."""
        self._waiting.clear()

    def _vent(self, now: Now, request: RequestPayload) -> list[AnswerPayload]:
        """Put a vent first, and refuse earlier requests: they must not bend the vine after the vent."""
        overtaken = [each.request for each in self._waiting if each.request.command != "vent"]
        self._waiting = deque(each for each in self._waiting if each.request.command == "vent")
        # One vent is carried out for all waiting vent requests. A request above the limit gets no answer.
        if len(self._waiting) < MAX_WAITING:
            self._waiting.append(QueuedRequest(request, made_at(now, request)))
        return [refused(now, earlier, "overtaken by a vent") for earlier in overtaken]

    def _read(self, now: Now, payload: bytes, retained: bool) -> tuple[RequestPayload | None, str]:
        """The request (None if it cannot be read), and why it is refused (empty if it is accepted)."""
        if len(payload) > MAX_REQUEST_LENGTH:
            return None, f"longer than {MAX_REQUEST_LENGTH} bytes"
        try:
            request = _DECODER.decode(payload)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            return None, f"invalid request: {error}"
        if request.command not in self._commands:
            allowed = ", ".join(self._commands) or "nothing"
            return (
                request,
                f"'{request.command}' is not permitted over MQTT; the configuration permits {allowed}",
            )
        if retained:
            return request, "a retained message: the time of the request is unknown"
        age_s = now.unix_s - request.unix_s
        if abs(age_s) > ASKED_WITHIN_S:
            when = f"{age_s:.1f} s ago" if age_s > 0 else f"{-age_s:.1f} s in the future"
            return request, f"requested {when} by this vehicle's clock; the limit is {ASKED_WITHIN_S:g} s"
        try:
            messages.Request(0, "broker", request.command, request.value, request.name)
        except ValueError as error:
            return request, str(error)
        return request, "" if self._is_new(now, request) else "repeated: each request needs a new id"

    def _is_new(self, now: Now, request: RequestPayload) -> bool:
        """True if the id is new. Old ids are dropped, because old requests are refused anyway."""
        while self._known:
            oldest = next(iter(self._known))
            if abs(now.unix_s - self._known[oldest]) <= ASKED_WITHIN_S:
                break
            del self._known[oldest]
        if request.id in self._known:
            return False
        if len(self._known) >= MAX_STORED_IDS:
            del self._known[next(iter(self._known))]
        self._known[request.id] = request.unix_s
        return True

    def _may_be_vent(self, payload: bytes) -> bool:
        return "vent" in self._commands and len(payload) <= MAX_REQUEST_LENGTH and _VENT in payload


def made_at(now: Now, request: RequestPayload) -> float:
    """Time of the request on the monotonic clock; a time in the future counts as now."""
    return now.t - max(0.0, now.unix_s - request.unix_s)


def refused(now: Now, request: RequestPayload | None, why: str) -> AnswerPayload:
    return AnswerPayload(unix_s=now.unix_s, id=request.id if request else None, safety="refused", reason=why)
