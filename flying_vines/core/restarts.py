"""Texts about a board that restarts repeatedly: one at the first restart, then a count every 10 s."""

from __future__ import annotations

import math

SERIES_ENDS_AFTER_S = 10.0
"""A series ends after this time without a restart."""
COUNT_EVERY_S = 10.0


class Restarts:
    """One series: each restart comes within `SERIES_ENDS_AFTER_S` of the one before."""

    def __init__(self, board: str) -> None:
        self._board = board
        self._end()

    def _end(self) -> None:
        self._count = self._reported_count = 0
        self._first_at = self._last_at = self._reported_at = -math.inf
        self._texts: set[str] = set()

    def note(self, t: float) -> bool:
        """Note a restart of the board. Returns True for the first one of a series: the pilot gets a text."""
        if self._count and t - self._last_at >= SERIES_ENDS_AFTER_S:
            self._end()
        self._count += 1
        self._last_at = t
        if self._count > 1:
            return False
        self._first_at = self._reported_at = t
        self._reported_count = 1
        return True

    def is_new_text(self, text: str) -> bool:
        """Note a text about the board. Returns False if the present series has shown it already."""
        if not self._count:
            return True
        new = text not in self._texts
        self._texts.add(text)
        return new

    def looping(self, t: float) -> str:
        """The text "… restarted N times in M s"; empty if there is no series, or only one restart."""
        if self._count < 2 or t - self._last_at >= SERIES_ENDS_AFTER_S:
            return ""
        lasts_s = max(1, round(self._last_at - self._first_at))
        return f"{self._board} restarted {self._count} times in {lasts_s} s"

    def tick(self, t: float) -> str:
        """Let time pass. Returns the text that is due now, or an empty one."""
        text = ""
        if self._count > self._reported_count and t - self._reported_at >= COUNT_EVERY_S:
            text = self.looping(t)
            self._reported_count, self._reported_at = self._count, t
        if self._count and t - self._last_at >= SERIES_ENDS_AFTER_S:
            self._end()
        return text
