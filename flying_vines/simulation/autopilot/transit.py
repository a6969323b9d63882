"""Bytes between the autopilot and its links: a mute drops them, a stall delays them."""

from __future__ import annotations

from dataclasses import dataclass, field

from flying_vines.simulation.autopilot.scheduler import Scheduler


@dataclass(slots=True)
class _Stall:
    """A link that delays its frames."""

    both_ways: bool
    until_s: float = 0.0
    outgoing: list[bytes] = field(default_factory=list)
    incoming: list[bytes] = field(default_factory=list)


class Transit:
    """Queues sent frames until they are taken, and received bytes of a link that is stalled both ways."""

    def __init__(self, scheduler: Scheduler) -> None:
        self._scheduler = scheduler
        self._sent: list[tuple[str, bytes]] = []
        self._stalls: dict[str, _Stall] = {}
        self._muted_until_s = -1.0

    @property
    def muted(self) -> bool:
        return self._scheduler.now_s < self._muted_until_s

    def mute(self, seconds: float) -> None:
        self._muted_until_s = self._scheduler.now_s + seconds

    def stall(self, link: str, seconds: float, both_ways: bool) -> None:
        stall = self._stalls.setdefault(link, _Stall(both_ways))
        stall.both_ways, stall.until_s = both_ways, self._scheduler.now_s + seconds

    def send(self, link: str, frame: bytes) -> None:
        if self.muted:
            return
        if link in self._stalls:
            self._stalls[link].outgoing.append(frame)
        else:
            self._sent.append((link, frame))

    def delays(self, link: str, data: bytes) -> bool:
        """Store received bytes if their link is stalled both ways. True if they were stored."""
        stall = self._stalls.get(link)
        if stall is None or not stall.both_ways:
            return False
        stall.incoming.append(data)
        return True

    def end_stalls(self) -> list[tuple[str, bytes]]:
        """End the stalls whose time is over, and return their received bytes. Their frames are sent first."""
        received = []
        for link, stall in list(self._stalls.items()):
            if self._scheduler.now_s >= stall.until_s:
                del self._stalls[link]
                self._sent[:0] = [(link, frame) for frame in stall.outgoing]
                received += [(link, data) for data in stall.incoming]
        return received

    def take(self) -> list[tuple[str, bytes]]:
        """The frames sent since the last call."""
        taken, self._sent = self._sent, []
        return taken
