"""Runs the monitor of the phloSAR's line on a real port."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import NamedTuple

from firmware_link.host import FirmwareReset, HostEvent, Incompatible, Ready
from firmware_link.monitor import Monitor, SeenFrame
from firmware_link.settings import SettingsExchange
from firmware_link.statistics import LinkStatistics
from flying_vines.config.address import Address
from flying_vines.vehicle.mavlink.link import open_link

TICK_S = 0.01


class LinkNote(NamedTuple):
    """A text about the line."""

    t: float
    text: str
    good: bool


LinkEvent = SeenFrame | LinkNote


class LinkWatch:
    """Monitors the board at `address`. Times are seconds since the watch began."""

    def __init__(self, address: Address, settings: SettingsExchange | None = None) -> None:
        self.monitor = Monitor(settings)
        self.answered = False
        """A firmware of our version has answered."""
        self.port = LinkNote(0.0, "opening", False)
        """The state of the port, and of the board on it."""
        self._opened = self.port
        self.clean_since: LinkStatistics | None = None
        """The statistics at the latest handshake. Bad frames before it do not count."""
        self._received: list[LinkEvent] = []
        self._began = asyncio.get_running_loop().time()
        self._link = open_link(address, self._bytes, self._state)

    @property
    def t(self) -> float:
        return asyncio.get_running_loop().time() - self._began

    @property
    def statistics(self) -> LinkStatistics:
        return self.monitor.statistics(self.t, self._link.dropped_bytes)

    async def run(self, show: Callable[[Sequence[LinkEvent]], None], over: Callable[[], bool]) -> None:
        """Run until `over`. At every tick `show` gets the new frames and notes, in order."""
        opening = asyncio.create_task(self._link.run())
        try:
            while not over() and not opening.done():
                data, sent = self.monitor.tick(self.t)
                if data:
                    self._link.write(data)
                self._received += sent
                news = self.monitor.answer_check.news(self.t)
                if news:
                    self._report_port(news, False)
                show(self._take_received())
                await asyncio.sleep(TICK_S)
        finally:
            opening.cancel()
            await asyncio.wait([opening])
        show(self._take_received())
        if not opening.cancelled():
            opening.result()

    def _take_received(self) -> list[LinkEvent]:
        received, self._received = self._received, []
        return received

    def _bytes(self, data: bytes) -> None:
        seen, events = self.monitor.receive(self.t, data)
        self._received += seen
        for event in events:
            self._take(event)

    def _state(self, up: bool, why: str) -> None:
        if up:
            self.monitor.opened(self.t)
        else:
            self.monitor.closed(self.t)
        self._report_port(why or "the port is open", up)
        self._opened = self.port

    def _take(self, event: HostEvent) -> None:
        match event:
            case Ready(welcome):
                self.answered = True
                self.port = self._opened
                self.clean_since = self.statistics
                self._report(f"the firmware {welcome.firmware_build!r} answers", True)
            case FirmwareReset(reason):
                self._report(f"the firmware restarted: {reason}", False)
            case Incompatible(reason):
                self._report_port(reason, False)

    def _report_port(self, text: str, good: bool) -> None:
        self.port = LinkNote(self.t, text, good)
        self._received.append(self.port)

    def _report(self, text: str, good: bool) -> None:
        self._received.append(LinkNote(self.t, text, good))
