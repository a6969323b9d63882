"""A board that restarts again and again: the pilot is told the first time at once, then how often."""

from __future__ import annotations

import math

OVER_S = 10.0
"""So long after its last restart a board is believed to stay up."""
TELLS_EVERY_S = 10.0


class Restarts:
    """Of one series: restarts of which none comes later than `OVER_S` after the one before it."""

    def __init__(self) -> None:
        self._end()

    def _end(self) -> None:
        self._count = self._told_count = 0
        self._first_at = self._last_at = self._told_at = -math.inf
        self._said: set[str] = set()

    def note(self, t: float) -> bool:
        """The board restarted. Whether that is told at once: it is the first of a series."""
        if self._count and t - self._last_at >= OVER_S:
            self._end()
        self._count += 1
        self._last_at = t
        if self._count > 1:
            return False
        self._first_at = self._told_at = t
        self._told_count = 1
        return True

    def news(self, text: str) -> bool:
        """Whether a text on the board is to be told: each is once in a series."""
        if not self._count:
            return True
        new = text not in self._said
        self._said.add(text)
        return new

    def looping(self, t: float) -> str:
        """How often and in how long, for people; empty where it is one restart or none, or over."""
        if self._count < 2 or t - self._last_at >= OVER_S:
            return ""
        lasts_s = max(1, round(self._last_at - self._first_at))
        return f"phloSAR restarted {self._count} times in {lasts_s} s"

    def due(self, t: float) -> str:
        """What is to be told at a tick, if anything."""
        told = ""
        if self._count > self._told_count and t - self._told_at >= TELLS_EVERY_S:
            told = self.looping(t)
            self._told_count, self._told_at = self._count, t
        if self._count and t - self._last_at >= OVER_S:
            self._end()
        return told
