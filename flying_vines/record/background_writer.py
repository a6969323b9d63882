"""A thread that writes, so that the caller never waits.

A worn card hangs for seconds; a terminal freezes when its network does. The vine's setpoints come from the
same loop as what is written, and the firmware's dead-man waits for them a quarter of a second.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import SimpleQueue
from typing import Generic, TypeVar

T = TypeVar("T")


class BackgroundWriter(Generic[T]):
    """Passes what is written to `put`, in order. The first `OSError` ends it: see `error`."""

    def __init__(self, put: Callable[[list[T]], None], most_behind: int) -> None:
        """While an amount of `most_behind` waits, `write` accepts nothing more."""
        self.error: OSError | None = None
        self._put = put
        self._most_behind = most_behind
        # Each is changed by one thread only.
        self._taken = self._done = 0
        self._waiting: SimpleQueue[tuple[T, int] | None] = SimpleQueue()
        # A daemon: the process must be able to end although `put` never returns.
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def write(self, what: T, size: int) -> bool:
        """Whether there was room for it."""
        if self._taken - self._done + size > self._most_behind:
            return False
        self._taken += size
        self._waiting.put((what, size))
        return True

    def close(self, within_s: float) -> bool:
        """Whether everything was written, or has failed, within that time."""
        self._waiting.put(None)
        self._thread.join(within_s)
        return not self._thread.is_alive()

    def _work(self) -> None:
        last = False
        while not last:
            # All that waits at once: a slow `put` is called less often.
            taken = [self._waiting.get()]
            while not self._waiting.empty():
                taken.append(self._waiting.get())
            last = taken[-1] is None
            together = [one for one in taken if one is not None]
            if self.error is None and together:
                try:
                    self._put([what for what, _ in together])
                except OSError as error:
                    self.error = error
            self._done += sum(size for _, size in together)
