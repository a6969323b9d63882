"""Timed callbacks without a clock."""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(slots=True)
class ScheduledCallback:
    """One scheduled callback, or a repeated one; `cancel` removes it."""

    callback: Callable[[], None]
    begin_s: float
    interval_s: float = 0.0
    count: int = 0
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
        return self._schedule(ScheduledCallback(callback, t_s))

    def after(self, delay_s: float, callback: Callable[[], None]) -> ScheduledCallback:
        return self.at(self.now_s + delay_s, callback)

    def every(
        self, interval_s: float, callback: Callable[[], None], begin_s: float | None = None
    ) -> ScheduledCallback:
        """Call at `begin_s` (default: one interval from now), and then every `interval_s`."""
        if begin_s is None:
            return self._schedule(ScheduledCallback(callback, self.now_s, interval_s, 1))
        return self._schedule(ScheduledCallback(callback, begin_s, interval_s))

    def _schedule(self, entry: ScheduledCallback) -> ScheduledCallback:
        # Computed from a count, so that rounding errors do not add up.
        due_s = entry.begin_s + entry.count * entry.interval_s
        self._entries += 1
        heapq.heappush(self._heap, (due_s, self._entries, entry))
        return entry

    def run_until(self, t_s: float) -> None:
        """Run everything due up to and including `t_s`; a time in the past changes nothing."""
        while self._heap and self._heap[0][0] <= t_s:
            due_s, _, entry = heapq.heappop(self._heap)
            if entry.cancelled:
                continue
            self.now_s = max(self.now_s, due_s)
            if entry.interval_s:
                entry.count += 1
                self._schedule(entry)
            entry.callback()
        self.now_s = max(self.now_s, t_s)

    def clear(self) -> None:
        """Remove all callbacks."""
        self._heap.clear()
