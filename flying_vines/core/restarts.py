"""A board that restarts again and again: the pilot reads of the first restart at once, then how often."""

from __future__ import annotations

import math

OVER_S = 10.0
"""A series of restarts is over when none came for so long."""
TELLS_EVERY_S = 10.0


class Restarts:
    """One series: each restart comes within `OVER_S` of the one before."""

    def __init__(self) -> None:
        self._end()

    def _end(self) -> None:
        self._count = self._told_count = 0
        self._first_at = self._last_at = self._told_at = -math.inf
        self._said: set[str] = set()

    def note(self, t: float) -> bool:
        """Note a restart of the board. Returns whether to tell it at once: it is the first of a series."""
        if self._count and t - self._last_at >= OVER_S:
            self._end()
        self._count += 1
        self._last_at = t
        if self._count > 1:
            return False
        self._first_at = self._told_at = t
        self._told_count = 1
        return True

    def say_once(self, text: str) -> bool:
        """Note a text about the board. Returns whether to tell it: each is told once in a series."""
        if not self._count:
            return True
        new = text not in self._said
        self._said.add(text)
        return new

    def looping(self, t: float) -> str:
        """How often in how long; empty after fewer than two restarts, or when the series is over."""
        if self._count < 2 or t - self._last_at >= OVER_S:
            return ""
        lasts_s = max(1, round(self._last_at - self._first_at))
        return f"phloSAR restarted {self._count} times in {lasts_s} s"

    def tick(self, t: float) -> str:
        """Let time pass. Returns what to tell now, if anything."""
        told = ""
        if self._count > self._told_count and t - self._told_at >= TELLS_EVERY_S:
            told = self.looping(t)
            self._told_count, self._told_at = self._count, t
        if self._count and t - self._last_at >= OVER_S:
            self._end()
        return told
