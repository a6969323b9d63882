"""What may be asked for over the broker: what the configuration lists, asked just now, once. No clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from itertools import islice, takewhile
from typing import NamedTuple

import msgspec

from flying_vines.gateway import messages
from flying_vines.gateway.mqtt.payloads import AnswerPayload, RequestPayload
from flying_vines.gateway.mqtt.teller import Now
from flying_vines.gateway.token_bucket import TokenBucket
from flying_vines.vine.intent import CommandName

LONGEST_ASK = 1024
MOST_AT_ONCE, MOST_PER_S = 10.0, 5.0
"""Whoever asks more often is not answered; but a vent is carried out."""
MOST_WAITING = 20
MOST_REMEMBERED = 2000
_VENT = b'"vent"'
_DECODER = msgspec.json.Decoder(RequestPayload)


class Waiting(NamedTuple):
    """What is to be handed to the service, and when it was asked for by the clock that nobody sets."""

    ask: RequestPayload
    made_at: float


class Asks:
    """Judges what comes in, and says what is to be handed to the service, one after another."""

    def __init__(self, commands: Sequence[CommandName], within_s: float) -> None:
        self._commands = commands
        self._within_s = within_s
        self._known: dict[str, float] = {}
        """When each was asked, by its id."""
        self._waiting: deque[Waiting] = deque()
        self._bucket = TokenBucket(0.0, MOST_AT_ONCE, MOST_PER_S)
        self.ignored = 0

    def hear(self, now: Now, payload: bytes, retained: bool) -> list[AnswerPayload]:
        """One message on the topic, and whoever is answered at once."""
        # Of a flood most is not even read.
        may_be_vent = self._may_be_vent(payload)
        if not may_be_vent and not self._bucket.take(now.t):
            self.ignored += 1
            return []
        ask, problem = self._read(now, payload, retained)
        if ask is not None and not problem and ask.command == "vent":
            return self._vent(now, ask)
        if may_be_vent and not self._bucket.take(now.t):
            self.ignored += 1
            return []
        if ask is None or problem:
            return [refused(now, ask, problem)]
        if len(self._waiting) >= MOST_WAITING:
            return [refused(now, ask, "too much was asked for at once")]
        self._waiting.append(Waiting(ask, made_at(now, ask)))
        return []

    @property
    def waits(self) -> bool:
        """Whether anything is to be handed to the service."""
        return bool(self._waiting)

    def next(self) -> list[Waiting]:
        """To be asked of the service now, as one: all the vents that wait, or the first of what else does."""
        vents = list(takewhile(lambda each: each.ask.command == "vent", self._waiting))
        together = vents or list(islice(self._waiting, 1))
        for _ in together:
            self._waiting.popleft()
        return together

    def disconnected(self) -> None:
        """What waits is not to come as a surprise when the broker is back."""
        self._waiting.clear()

    def _vent(self, now: Now, ask: RequestPayload) -> list[AnswerPayload]:
        """Before all else; what was asked for earlier is not to bend the vine afterwards."""
        overtaken = [each.ask for each in self._waiting if each.ask.command != "vent"]
        self._waiting = deque(each for each in self._waiting if each.ask.command == "vent")
        # One vent serves all who wait for it; not all can be answered.
        if len(self._waiting) < MOST_WAITING:
            self._waiting.append(Waiting(ask, made_at(now, ask)))
        return [refused(now, earlier, "overtaken by a vent") for earlier in overtaken]

    def _read(self, now: Now, payload: bytes, retained: bool) -> tuple[RequestPayload | None, str]:
        """What is asked for, as far as it can be read, and why it is refused, if it is."""
        if len(payload) > LONGEST_ASK:
            return None, f"longer than {LONGEST_ASK} bytes"
        try:
            ask = _DECODER.decode(payload)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            return None, f"not understood: {error}"
        if ask.command not in self._commands:
            allowed = ", ".join(self._commands) or "nothing"
            return ask, f"'{ask.command}' may not be asked for over MQTT; the profile lists {allowed}"
        if retained:
            return ask, "a retained message: nobody knows when it was asked"
        age_s = now.unix_s - ask.unix_s
        if abs(age_s) > self._within_s:
            when = f"{age_s:.1f} s ago" if age_s > 0 else f"{-age_s:.1f} s from now"
            return ask, f"asked {when} by this vehicle's clock, {self._within_s:g} s are allowed"
        try:
            messages.Request(0, "broker", ask.command, ask.value, ask.name)
        except ValueError as error:
            return ask, str(error)
        return ask, "" if self._is_new(now, ask) else "asked before: each needs an id of its own"

    def _is_new(self, now: Now, ask: RequestPayload) -> bool:
        """Only as long as it is not too old need an id be remembered."""
        while self._known:
            oldest = next(iter(self._known))
            if abs(now.unix_s - self._known[oldest]) <= self._within_s:
                break
            del self._known[oldest]
        if ask.id in self._known:
            return False
        if len(self._known) >= MOST_REMEMBERED:
            del self._known[next(iter(self._known))]
        self._known[ask.id] = ask.unix_s
        return True

    def _may_be_vent(self, payload: bytes) -> bool:
        return "vent" in self._commands and len(payload) <= LONGEST_ASK and _VENT in payload


def made_at(now: Now, ask: RequestPayload) -> float:
    """As old as it says that it is, and at least as old as it has been here."""
    return now.t - max(0.0, now.unix_s - ask.unix_s)


def refused(now: Now, ask: RequestPayload | None, why: str) -> AnswerPayload:
    return AnswerPayload(unix_s=now.unix_s, id=ask.id if ask else None, safety="refused", reason=why)
