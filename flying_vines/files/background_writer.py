"""A thread that writes, so that the caller never waits.

A worn SD card may hang for seconds, and a terminal hangs with its network. The caller's loop also sends the
vine's setpoints, and the firmware's dead-man timer allows only 250 ms between them.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import SimpleQueue
from typing import Generic, TypeVar

T = TypeVar("T")


class BackgroundWriter(Generic[T]):
    """Passes data to `put` in a thread, in order. After the first `OSError` (`error`) it drops all data."""

    def __init__(self, put: Callable[[list[T]], None], max_size: int) -> None:
        """`max_size`: the maximum total size of the queue. `write` refuses data beyond it."""
        self.error: OSError | None = None
        self._put = put
        self._max_size = max_size
        # Only the caller changes `_taken`, only the thread changes `_done`.
        self._taken = self._done = 0
        self._waiting: SimpleQueue[tuple[T, int] | None] = SimpleQueue()
        # A daemon thread: the process must be able to end even if `put` never returns.
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def write(self, data: T, size: int) -> bool:
        """Queue data. Returns False if there was no room for it."""
        if self._taken - self._done + size > self._max_size:
            return False
        self._taken += size
        self._waiting.put((data, size))
        return True

    def close(self, within_s: float) -> bool:
        """Write the queue and end the thread. Returns False if the thread still runs after `within_s`."""
        self._waiting.put(None)
        self._thread.join(within_s)
        return not self._thread.is_alive()

    def _work(self) -> None:
        last = False
        while not last:
            # Take the whole queue, so that a slow `put` is called less often.
            taken = [self._waiting.get()]
            while not self._waiting.empty():
                taken.append(self._waiting.get())
            last = taken[-1] is None
            batch = [item for item in taken if item is not None]
            if self.error is None and batch:
                try:
                    self._put([data for data, _ in batch])
                except OSError as error:
                    self.error = error
            self._done += sum(size for _, size in batch)
