"""How many connections there may be at once. A holder of the full token always gets one. No clock."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Generic, TypeVar

K = TypeVar("K")

MAX_NEW = 128
"""Connections that have not opened the page's socket."""
NEW_FOR_S = 20.0
"""Time to ask for what is wanted, and to read it."""
MAX_VIEWERS = 64
MAX_PILOTS = 16
"""Holders of the full token. No viewer takes one of these places."""


@dataclass(slots=True)
class _New:
    address: str
    came_at: float


class Connections(Generic[K]):
    """Connections, each by whatever the caller knows it by. Times in seconds of one clock.

    What these methods return has lost its place: the caller closes it.
    """

    def __init__(self) -> None:
        self._new: dict[K, _New] = {}
        self._viewers: set[K] = set()
        self._pilots: dict[K, None] = {}
        """The oldest first."""

    def came(self, who: K, address: str, t: float) -> K | None:
        """When there are too many new ones, the oldest of the address that has the most goes."""
        self._new[who] = _New(address, t)
        if len(self._new) <= MAX_NEW:
            return None
        (crowded, _), *_ = Counter(new.address for new in self._new.values()).most_common(1)
        oldest = next(key for key, new in self._new.items() if new.address == crowded)
        del self._new[oldest]
        return oldest

    def view(self, who: K) -> bool:
        """Whether there is room for one more viewer."""
        if len(self._viewers) >= MAX_VIEWERS:
            return False
        self._new.pop(who, None)
        self._viewers.add(who)
        return True

    def command(self, who: K) -> K | None:
        """There is always room for one more pilot: when there are too many, the oldest goes."""
        self._new.pop(who, None)
        self._pilots[who] = None
        if len(self._pilots) <= MAX_PILOTS:
            return None
        oldest = next(iter(self._pilots))
        del self._pilots[oldest]
        return oldest

    def left(self, who: K) -> None:
        self._new.pop(who, None)
        self._viewers.discard(who)
        self._pilots.pop(who, None)

    def overdue(self, t: float) -> list[K]:
        """Those that have been new for too long."""
        late = [key for key, new in self._new.items() if t - new.came_at > NEW_FOR_S]
        for key in late:
            del self._new[key]
        return late
