"""What is to happen when: timed callbacks without a clock."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(slots=True)
class AgendaEntry:
    """One thing on the agenda; `cancel` it and it will not happen."""

    callback: Callable[[], None]
    cancelled: bool = False

    def cancel(self) -> None:
        self.cancelled = True


class Agenda:
    """Runs callbacks in order of their time; `now_s` is the time of the one that is running.

    Callbacks due at the same time run in the order in which they were put down, so a run is
    reproducible however time is cut into calls of `run_until`.
    """

    def __init__(self) -> None:
        self.now_s = 0.0
        self._heap: list[tuple[float, int, AgendaEntry]] = []
        self._order = itertools.count()

    def at(self, t_s: float, callback: Callable[[], None]) -> AgendaEntry:
        entry = AgendaEntry(callback)
        heapq.heappush(self._heap, (t_s, next(self._order), entry))
        return entry

    def after(self, delay_s: float, callback: Callable[[], None]) -> AgendaEntry:
        return self.at(self.now_s + delay_s, callback)

    def run_until(self, t_s: float) -> None:
        """Run everything due up to and including `t_s`; a time in the past changes nothing."""
        while self._heap and self._heap[0][0] <= t_s:
            due_s, _, entry = heapq.heappop(self._heap)
            if entry.cancelled:
                continue
            self.now_s = max(self.now_s, due_s)
            entry.callback()
        self.now_s = max(self.now_s, t_s)

    def clear(self) -> None:
        """Forget everything that was to come."""
        self._heap.clear()
