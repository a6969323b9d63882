"""How many may be there at once, so that a thousand connections keep nobody out who belongs here."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Generic, TypeVar

from flying_vines.gateway.patience import Patience

K = TypeVar("K")

MOST_STRANGERS = 64
"""Connections that have not opened the page's socket."""
PATIENCE_S = 20.0
"""For a stranger to ask for what he wants and to read it."""
MOST_VIEWERS = 64
MOST_VIEWERS_EACH = 16
"""Of one address."""
COME_AT_ONCE, COME_PER_S = 64.0, 20.0
"""Connections and requests of one address. A page that opens takes fifteen of them."""
MOST_ADDRESSES = 256


@dataclass(slots=True)
class _Stranger:
    address: str
    came_at: float


class Crowd(Generic[K]):
    """Connections, each by whatever the caller knows it by. Times in seconds of one clock."""

    def __init__(self) -> None:
        self._strangers: dict[K, _Stranger] = {}
        self._viewers: dict[K, str] = {}
        self._patience: dict[str, Patience] = {}
        """With each address that came lately."""

    def bears(self, address: str, t: float) -> bool:
        """Whether one more connection or request of an address is to be looked at."""
        patience = self._patience.get(address)
        if patience is None:
            if len(self._patience) >= MOST_ADDRESSES:
                self._forget(t)
            patience = self._patience[address] = Patience(t, COME_AT_ONCE, COME_PER_S)
        return patience.bears(t)

    def _forget(self, t: float) -> None:
        """Addresses that make no trouble; if all do, the one that was first."""
        restless = {address: with_ for address, with_ in self._patience.items() if not with_.is_rested(t)}
        if len(restless) >= MOST_ADDRESSES:
            del restless[next(iter(restless))]
        self._patience = restless

    def came(self, who: K, address: str, t: float) -> K | None:
        """A new connection; the one that must go for it: the oldest of the address that has the most."""
        self._strangers[who] = _Stranger(address, t)
        if len(self._strangers) <= MOST_STRANGERS:
            return None
        (crowded, _), *_ = Counter(stranger.address for stranger in self._strangers.values()).most_common(1)
        oldest = next(key for key, stranger in self._strangers.items() if stranger.address == crowded)
        del self._strangers[oldest]
        return oldest

    def look_on(self, who: K) -> str:
        """A connection becomes a viewer's; or else why not."""
        stranger = self._strangers.get(who)
        if stranger is None:
            return "too many connections"
        if len(self._viewers) >= MOST_VIEWERS:
            return f"{MOST_VIEWERS} viewers are there already"
        if list(self._viewers.values()).count(stranger.address) >= MOST_VIEWERS_EACH:
            return f"{MOST_VIEWERS_EACH} viewers are there already from {stranger.address}"
        del self._strangers[who]
        self._viewers[who] = stranger.address
        return ""

    def left(self, who: K) -> None:
        self._strangers.pop(who, None)
        self._viewers.pop(who, None)

    def overdue(self, t: float) -> list[K]:
        """Strangers that were there long enough, and are gone now."""
        late = [key for key, stranger in self._strangers.items() if t - stranger.came_at > PATIENCE_S]
        for key in late:
            del self._strangers[key]
        return late
