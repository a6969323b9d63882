"""Text that a thread of its own puts where it belongs, so that whoever writes never waits.

A worn card hangs for seconds; a terminal freezes when its network does. The vine's setpoints come from the
same loop as what is written, and the firmware's dead-man waits for them a quarter of a second.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import SimpleQueue


class Aside:
    """Hands texts to `put`, in order. The first `OSError` ends it: see `error`."""

    def __init__(self, put: Callable[[str], None], most_behind: int) -> None:
        """Of what is written while `most_behind` characters wait, nothing is kept."""
        self.error: OSError | None = None
        self._put = put
        self._most_behind = most_behind
        # Each counted by one thread alone.
        self._taken = self._done = 0
        self._waiting: SimpleQueue[str | None] = SimpleQueue()
        # A daemon, for where `put` never returns the process must still be able to end.
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def write(self, text: str) -> bool:
        """Whether there was room for it."""
        if self._taken - self._done + len(text) > self._most_behind:
            return False
        self._taken += len(text)
        self._waiting.put(text)
        return True

    def close(self, within_s: float) -> bool:
        """Whether all that was written is done, or has failed, within that time."""
        self._waiting.put(None)
        self._thread.join(within_s)
        return not self._thread.is_alive()

    def _work(self) -> None:
        text: str | None = ""
        while text is not None:
            # All that waits, at once: the slower `put` is, the less often it is asked.
            texts = [self._waiting.get()]
            while not self._waiting.empty():
                texts.append(self._waiting.get())
            text = texts[-1]
            together = "".join(filter(None, texts))
            if self.error is None and together:
                try:
                    self._put(together)
                except OSError as error:
                    self.error = error
            self._done += len(together)
