"""Limits the number of connections. A holder of the full token always gets one."""

from __future__ import annotations

from collections import Counter
from typing import Generic, TypeVar

K = TypeVar("K")

MAX_NEW = 128
"""Maximum number of connections that have not opened the page's socket."""
MAX_VIEWERS = 64
MAX_PILOTS = 16
"""Maximum number of holders of the full token. Viewers do not take these places."""


class Connections(Generic[K]):
    """The open connections, by the caller's own keys.

    The caller closes the connection that a method returns, because it has lost its place.
    """

    def __init__(self) -> None:
        self._new: dict[K, str] = {}
        """New connections and their addresses, the oldest first."""
        self._viewers: set[K] = set()
        self._pilots: dict[K, None] = {}
        """The oldest first."""

    def opened(self, who: K, address: str) -> K | None:
        """If there are too many new connections, the address with most of them loses its oldest one."""
        self._new[who] = address
        if len(self._new) <= MAX_NEW:
            return None
        ((busiest, _),) = Counter(self._new.values()).most_common(1)
        oldest = next(key for key, address in self._new.items() if address == busiest)
        del self._new[oldest]
        return oldest

    def add_viewer(self, who: K) -> bool:
        """Returns True if there was a place for the viewer."""
        if len(self._viewers) >= MAX_VIEWERS:
            return False
        self._new.pop(who, None)
        self._viewers.add(who)
        return True

    def add_pilot(self, who: K) -> K | None:
        """A pilot always gets a place. If there are too many, the oldest loses its place."""
        self._new.pop(who, None)
        self._pilots[who] = None
        if len(self._pilots) <= MAX_PILOTS:
            return None
        oldest = next(iter(self._pilots))
        del self._pilots[oldest]
        return oldest

    def closed(self, who: K) -> None:
        self._new.pop(who, None)
        self._viewers.discard(who)
        self._pilots.pop(who, None)
