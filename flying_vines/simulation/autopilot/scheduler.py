"""Timed callbacks without a clock."""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(slots=True)
class ScheduledCallback:
    """One scheduled callback; `cancel` removes it."""

    callback: Callable[[], None]
    cancelled: bool = False

    def cancel(self) -> None:
        self.cancelled = True


class Scheduler:
    """Runs callbacks in order of time; `now_s` is the time of the running one.

    Callbacks of the same time run in the order in which they were scheduled. So the result does not depend on
    the times at which `run_until` is called.
    """

    def __init__(self) -> None:
        self.now_s = 0.0
        self._heap: list[tuple[float, int, ScheduledCallback]] = []
        self._entries = 0

    def at(self, t_s: float, callback: Callable[[], None]) -> ScheduledCallback:
        entry = ScheduledCallback(callback)
        self._entries += 1
        heapq.heappush(self._heap, (t_s, self._entries, entry))
        return entry

    def after(self, delay_s: float, callback: Callable[[], None]) -> ScheduledCallback:
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
        """Remove all callbacks."""
        self._heap.clear()
