"""Finds out if telemetry is new, by the board's clock in each message.

A message that arrives may still be old: a board that hangs, or a loop in the line, may repeat one frame for
ever. A repeated frame has the same clock.
"""

from __future__ import annotations

import math
from enum import Enum

REORDERED_MS = 100
"""If the board's clock goes back by at most this, messages were only reordered. A restart sets the clock to
zero. So a restart looks like reordering only if the board is then silent for about as long as it had run
before."""
FORGETS = 0.25
"""Seconds by which a difference between the clocks decays in each second. So a board that stalled once counts
as current again. A board whose clock runs at less than three quarters of ours always counts as stale."""
MAX_BEHIND_S = 1.0
"""Maximum of `behind_s`. It is longer than the delay in a serial port's buffer."""
LEAP_S = 1.0
AGREES_S = 0.05
"""After a leap the next message must continue from there within this tolerance."""
FULL_MS = 1 << 32
_HALF_MS = 1 << 31


class ClockVerdict(Enum):
    """The verdict on a message by its clock."""

    NEW = "new"
    OLD = "old"
    """A repeated message, or one that was overtaken by a newer one."""
    LEAPT = "leapt"
    """The clock is more than `LEAP_S` ahead. If the next message continues from this time, it is NEW."""
    BACK = "back"
    """The board restarted."""


class DeviceClock:
    """Compares the board's clock with ours. The board's clock wraps after 49 days."""

    def __init__(self) -> None:
        self.passed_ms = 0
        """Time between the last two new messages; 0 after a leap."""
        self.restart()

    def restart(self) -> None:
        """Accept any time in the next message."""
        self._last: tuple[float, int] | None = None
        self._leapt: tuple[float, int] | None = None
        self._ahead_s = 0.0
        """Time by which the board's clock is ahead of ours."""

    @property
    def behind_s(self) -> float:
        """Minimum age of the latest new message at its arrival."""
        return max(0.0, -self._ahead_s)

    def take(self, t: float, device_time_ms: int) -> ClockVerdict:
        """The verdict on a message that arrived at `t`."""
        now = t, device_time_ms
        if self._last is None:
            return self._accept(now, 0, 0.0)
        passed_ms = _passed_ms(self._last, now)
        if passed_ms < 0 and not -passed_ms <= REORDERED_MS <= device_time_ms:
            return ClockVerdict.BACK
        if passed_ms <= 0:
            return ClockVerdict.OLD
        ours_s = t - self._last[0]
        ahead_s = self._ahead_s + passed_ms / 1e3 - ours_s
        ahead_s -= math.copysign(min(abs(ahead_s), FORGETS * ours_s), ahead_s)
        if ahead_s <= LEAP_S:
            return self._accept(now, passed_ms, max(-MAX_BEHIND_S, ahead_s))
        before, self._leapt = self._leapt, now
        if before is None or not 0 < _passed_ms(before, now) <= 1e3 * (t - before[0] + AGREES_S):
            return ClockVerdict.LEAPT
        return self._accept(now, 0, 0.0)

    def _accept(self, now: tuple[float, int], passed_ms: int, ahead_s: float) -> ClockVerdict:
        self._last, self._leapt = now, None
        self.passed_ms, self._ahead_s = passed_ms, ahead_s
        return ClockVerdict.NEW


def _passed_ms(before: tuple[float, int], now: tuple[float, int]) -> int:
    """Time by the board's clock; negative if it went back. A wrap does not count as back."""
    passed_ms = (now[1] - before[1]) % FULL_MS
    return passed_ms if passed_ms < _HALF_MS else passed_ms - FULL_MS
