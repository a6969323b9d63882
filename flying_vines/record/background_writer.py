"""What a thread of its own puts where it belongs, so that whoever writes never waits.

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
    """Hands what is written to `put`, in order. The first `OSError` ends it: see `error`."""

    def __init__(self, put: Callable[[list[T]], None], most_behind: int) -> None:
        """Of what is written while as much as `most_behind` waits, nothing is kept."""
        self.error: OSError | None = None
        self._put = put
        self._most_behind = most_behind
        # Each counted by one thread alone.
        self._taken = self._done = 0
        self._waiting: SimpleQueue[tuple[T, int] | None] = SimpleQueue()
        # A daemon, for where `put` never returns the process must still be able to end.
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
        """Whether all that was written is done, or has failed, within that time."""
        self._waiting.put(None)
        self._thread.join(within_s)
        return not self._thread.is_alive()

    def _work(self) -> None:
        last = False
        while not last:
            # All that waits, at once: the slower `put` is, the less often it is asked.
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
