"""Status texts, changed and cut so that no other program acts on them.

Ground stations and autopilots parse status texts: some words mean a version, a failed check or a step of the
mission to them. The name of a profile or of a firmware build may contain such a word. So such words are
broken up before a text is sent. The text stays readable.
"""

from __future__ import annotations

import math
import re
import unicodedata
from bisect import bisect_left, insort
from collections import deque
from operator import attrgetter
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.notice import Notice, Severity
from flying_vines.vehicle.token_bucket import TokenBucket

OURS = "Vine:"
"""The prefix of every text. Other programs look for other prefixes."""
CHUNK_LENGTH = 50
MAX_TEXT_LENGTH = 4 * CHUNK_LENGTH - 1
"""Longer texts are cut, so that a text arrives soon."""
SPACING_S = 0.1
MAX_WAITING = 30
"""Maximum number of queued texts. To send so many takes some seconds."""
BURST = 20
PER_MINUTE = 30
"""The budget: so many texts on average, and `BURST` at once. Others wait."""
MAX_WAIT_S = 15.0
"""A text that has waited for longer is not sent, unless it is a warning of the service itself."""
RESERVED = 6
"""So many texts of the budget are only for the service's own warnings: losses and faults."""
SAME_AGAIN_S = 5.0
"""The same text is not sent again within this time, because ground stations speak texts aloud."""

_WRITTEN_OUT = str.maketrans(
    {
        "°": " deg", "µ": "u", "μ": "u", "…": "..", "×": "x", "·": "-", "−": "-", "–": "-", "—": "-",
        "→": "->", "≤": "<=", "≥": ">=", "±": "+/-", "’": "'", "‘": "'", "“": '"', "”": '"', "ß": "ss",
        "ø": "o", "#": " no. ",
    }
)  # fmt: skip

_WORDS = re.compile(
    "(cop)(ter)|(ro)(ver)|(pla)(ne)|(fra)(me)"  # Mission Planner reads a text with one of these as a version
    "|(pre)(arm)"  # shown on the screen as a failed check
    "|(radio fail)(safe)|(flight plan re)(ceived)|(ardupilot rea)(dy)",  # reserved for the autopilot
    re.IGNORECASE,
)
_LABELS = re.compile("(arm|tuning|mission):", re.IGNORECASE)


def harmless(text: str) -> str:
    """The text as one line of printable ASCII that no other program acts on. The function is idempotent.

    Characters outside ASCII are written out. A word that other programs look for gets a hyphen ("cop-ter").
    """
    plain = unicodedata.normalize("NFKD", text.translate(_WRITTEN_OUT)).translate(_WRITTEN_OUT)
    plain = "".join(_sign(sign) for sign in plain if not unicodedata.combining(sign))
    plain = " ".join(plain.split())
    if not plain.startswith(OURS):
        plain = f"{OURS} {plain}".rstrip()
    plain = _LABELS.sub(r"\1 :", plain)
    plain = _WORDS.sub(lambda found: "-".join(part for part in found.groups() if part), plain)
    return plain if len(plain) <= MAX_TEXT_LENGTH else plain[: MAX_TEXT_LENGTH - 2].rstrip() + ".."


_rank = attrgetter("rank")


def _sign(sign: str) -> str:
    if sign.isspace():
        return " "
    return sign if " " < sign <= "~" else "?"


class _Waiting(NamedTuple):
    rank: tuple[int, bool]
    """Severity, and if somebody's request caused the text. The lowest rank is sent first."""
    urgent: bool
    """A warning of the service itself."""
    since: float
    chunks: deque[MavlinkMessage]


class Texts:
    """The queue of status texts. Chunks are spaced, so that people can read them.

    The most severe text is sent first. Of two texts of one severity, the service's own (a loss, a fault) is
    sent before the answer to a request. If too many texts wait, the oldest of the last rank is dropped.
    However many texts there are, the ground station gets no more than the budget.
    """

    def __init__(self) -> None:
        self._sending: deque[MavlinkMessage] = deque()
        """The rest of a text of which some chunks have been sent."""
        self._waiting: list[_Waiting] = []
        """In the order of sending."""
        self._queued_at: dict[str, float] = {}
        self._budget = TokenBucket(0.0, BURST, PER_MINUTE / 60.0)
        self._sent_at = -math.inf
        self._identity = 0

    def say(self, notice: Notice) -> None:
        """Queue a text, made harmless. The same text within `SAME_AGAIN_S` is dropped."""
        t, text = notice.t, harmless(notice.text)
        while self._queued_at and t - next(iter(self._queued_at.values())) >= SAME_AGAIN_S:
            del self._queued_at[next(iter(self._queued_at))]
        if text in self._queued_at:
            return
        self._queued_at[text] = t
        rank = (int(notice.severity), bool(notice.source))
        chunks = self._chunks(notice.severity, text.encode("ascii"))
        urgent = notice.severity <= Severity.WARNING and not notice.source
        insort(self._waiting, _Waiting(rank, urgent, notice.t, chunks), key=_rank)
        if len(self._waiting) > MAX_WAITING:
            del self._waiting[bisect_left(self._waiting, self._waiting[-1].rank, key=_rank)]

    def due(self, t: float) -> list[MavlinkMessage]:
        if not (self._sending or self._waiting) or t - self._sent_at < SPACING_S:
            return []
        if not self._sending:
            first = self._waiting[0]
            if not first.urgent and t - first.since > MAX_WAIT_S:
                del self._waiting[0]
                return []
            if not self._budget.take(t, 0 if first.urgent else RESERVED):
                return []
            self._sending = self._waiting.pop(0).chunks
        self._sent_at = t
        return [self._sending.popleft()]

    def _chunks(self, severity: int, data: bytes) -> deque[MavlinkMessage]:
        parts = [data[i : i + CHUNK_LENGTH] for i in range(0, len(data), CHUNK_LENGTH)]
        if len(parts) == 1:
            return deque([mavlink.MAVLink_statustext_message(severity, data, 0, 0)])
        if len(parts[-1]) == CHUNK_LENGTH:
            parts.append(b"")  # MAVLink: the last chunk is one that is not full
        self._identity = self._identity % 0xFFFF + 1
        return deque(
            mavlink.MAVLink_statustext_message(severity, part, self._identity, number)
            for number, part in enumerate(parts)
        )
