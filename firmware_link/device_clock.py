"""Which telemetry is new, by the clock that the board writes into each message.

That something came says nothing: a board that hangs or a line that loops may repeat one frame for ever. The
sequence number of a frame adds nothing to this clock: a repeat has the same of both.
"""

from __future__ import annotations

import math
from enum import Enum

OVERTAKEN_MS = 100
"""Telemetry that is older than what came before it by no more than this was overtaken on its way. A board
that restarted is that near only if it was silent for as long as it had run before."""
FORGETS = 0.25
"""Of each second of ours, the share by which a difference between the clocks is forgotten. A clock that is
slower than three quarters of ours is therefore stale for ever; a board that stood still once is not."""
MOST_BEHIND_S = 1.0
"""More than waits in a serial port's buffer."""
LEAP_S = 1.0
SURE_S = 0.05
"""After a leap the next message must go on from there, this well."""
FULL_MS = 1 << 32
_HALF_MS = 1 << 31


class ClockVerdict(Enum):
    """What a message's clock says of it."""

    NEW = "new"
    OLD = "old"
    """A repeat, or overtaken on its way."""
    LEAPT = "leapt"
    """Too far ahead to be believed before the next message agrees."""
    BACK = "back"
    """The board restarted."""


class DeviceClock:
    """Compares the board's clock with ours. It wraps after 49 days."""

    def __init__(self) -> None:
        self.passed_ms = 0
        """Between the last two new messages; 0 over a leap."""
        self.restart()

    def restart(self) -> None:
        """The next message may have any time."""
        self._last: tuple[float, int] | None = None
        self._leapt: tuple[float, int] | None = None
        self._ahead_s = 0.0
        """What this clock has gained on ours."""

    @property
    def behind_s(self) -> float:
        """How old the latest new message was when it came, at least."""
        return max(0.0, -self._ahead_s)

    def take(self, t: float, device_time_ms: int) -> ClockVerdict:
        """A message that came at `t`."""
        now = t, device_time_ms
        if self._last is None:
            return self._believe(now, 0, 0.0)
        passed_ms = _passed_ms(self._last, now)
        if passed_ms < 0 and not -passed_ms <= OVERTAKEN_MS <= device_time_ms:
            return ClockVerdict.BACK
        if passed_ms <= 0:
            return ClockVerdict.OLD
        ours_s = t - self._last[0]
        ahead_s = self._ahead_s + passed_ms / 1e3 - ours_s
        ahead_s -= math.copysign(min(abs(ahead_s), FORGETS * ours_s), ahead_s)
        if ahead_s <= LEAP_S:
            return self._believe(now, passed_ms, max(-MOST_BEHIND_S, ahead_s))
        before, self._leapt = self._leapt, now
        if before is None or not 0 < _passed_ms(before, now) <= 1e3 * (t - before[0] + SURE_S):
            return ClockVerdict.LEAPT
        return self._believe(now, 0, 0.0)

    def _believe(self, now: tuple[float, int], passed_ms: int, ahead_s: float) -> ClockVerdict:
        self._last, self._leapt = now, None
        self.passed_ms, self._ahead_s = passed_ms, ahead_s
        return ClockVerdict.NEW


def _passed_ms(before: tuple[float, int], now: tuple[float, int]) -> int:
    """By the board's clock; negative when it ran backwards, but for a wrap."""
    passed_ms = (now[1] - before[1]) % FULL_MS
    return passed_ms if passed_ms < _HALF_MS else passed_ms - FULL_MS
