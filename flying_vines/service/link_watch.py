"""What goes over the phloSAR's line, watched: the monitor on a real port. No logic of its own."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import NamedTuple

from firmware_link.host import FirmwareReset, HostEvent, Incompatible, Ready
from firmware_link.monitor import Monitor, Seen
from firmware_link.settings import SettingsTalk
from firmware_link.statistics import LinkStatistics
from flying_vines.config.address import Address
from flying_vines.vehicle.mavlink.link import open_link

TICK_S = 0.01


class Told(NamedTuple):
    """Something about the line that is no frame."""

    t: float
    text: str
    good: bool


Heard = Seen | Told


class LinkWatch:
    """Greets whoever is at `address` and remembers what is said until `run` hands it over.

    Times are those of the event loop's clock since the watch began.
    """

    def __init__(self, address: Address, settings: SettingsTalk | None = None) -> None:
        self.monitor = Monitor(settings)
        self.answered = False
        """Whether a firmware of our version has been there."""
        self.port = Told(0.0, "opening", False)
        """How it is with the port now, and with whoever is on it."""
        self._opened = self.port
        self.clean_since: LinkStatistics | None = None
        """The counts when the firmware last answered: what was spoilt before is nobody's fault."""
        self._heard: list[Heard] = []
        self._began = asyncio.get_running_loop().time()
        self._link = open_link(address, self._bytes, self._state)

    @property
    def t(self) -> float:
        return asyncio.get_running_loop().time() - self._began

    @property
    def statistics(self) -> LinkStatistics:
        return self.monitor.statistics(self.t, self._link.dropped_bytes)

    async def run(self, show: Callable[[Sequence[Heard]], None], over: Callable[[], bool]) -> None:
        """Until `over`; `show` gets what was heard, in order, at every tick."""
        opening = asyncio.create_task(self._link.run())
        try:
            while not over() and not opening.done():
                data, sent = self.monitor.tick(self.t)
                if data:
                    self._link.write(data)
                self._heard += sent
                news = self.monitor.answer.news(self.t)
                if news:
                    self._tell_port(news, False)
                show(self._take_heard())
                await asyncio.sleep(TICK_S)
        finally:
            opening.cancel()
            await asyncio.wait([opening])
        show(self._take_heard())
        if not opening.cancelled():
            opening.result()

    def _take_heard(self) -> list[Heard]:
        heard, self._heard = self._heard, []
        return heard

    def _bytes(self, data: bytes) -> None:
        seen, events = self.monitor.receive(self.t, data)
        self._heard += seen
        for event in events:
            self._take(event)

    def _state(self, up: bool, why: str) -> None:
        if up:
            self.monitor.opened(self.t)
        else:
            self.monitor.closed(self.t)
        self._tell_port(why or "the port is open", up)
        self._opened = self.port

    def _take(self, event: HostEvent) -> None:
        match event:
            case Ready(welcome):
                self.answered = True
                self.port = self._opened
                self.clean_since = self.statistics
                self._tell(f"the firmware {welcome.firmware_build!r} answers", True)
            case FirmwareReset(reason):
                self._tell(f"the firmware restarted: {reason}", False)
            case Incompatible(reason):
                self._tell_port(reason, False)

    def _tell_port(self, text: str, good: bool) -> None:
        self.port = Told(self.t, text, good)
        self._heard.append(self.port)

    def _tell(self, text: str, good: bool) -> None:
        self._heard.append(Told(self.t, text, good))
