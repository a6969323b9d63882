"""A host that only looks: it greets, asks for the time, and shows every frame that goes over the line.

It never commands: a greeting already vents, and whoever is to command opens the port after us. It keeps no
other program from its work, for a port is opened by one alone.
"""

from __future__ import annotations

from typing import NamedTuple

from firmware_link import protocol
from firmware_link.answer import Answer
from firmware_link.framing import FRAME_END, FrameDecoder
from firmware_link.host import HostEvent, HostSession, SessionState
from firmware_link.protocol import (
    Codec,
    GetSetting,
    Hello,
    HostMessage,
    Message,
    Ping,
    ProtocolError,
    SetSetting,
)
from firmware_link.settings import SettingsTalk
from firmware_link.statistics import LinkStatistics, Traffic

_SAID = (Hello, Ping, GetSetting, SetSetting)
"""All that a monitor says."""


class SeenFrame(NamedTuple):
    """One frame, or what should have been one."""

    t: float
    sent: bool
    """By us; else by the device."""
    wire: bytes
    """As it went over the line, without the zero byte that ends it."""
    message: Message | None
    problem: str = ""
    """Why it is no message."""


class Tap:
    """The bytes of one direction, as frames. Never raises."""

    def __init__(self, sent: bool) -> None:
        self._sent = sent
        self._frames = FrameDecoder()

    def read(self, t: float, data: bytes) -> list[SeenFrame]:
        """The frames that end within `data`."""
        return [self._seen(t, wire, payload) for wire, payload in self._frames.frames(data)]

    def _seen(self, t: float, wire: bytes, payload: bytes | None) -> SeenFrame:
        if payload is None:
            return SeenFrame(t, self._sent, wire, None, "no frame, or one that was spoilt on its way")
        try:
            return SeenFrame(t, self._sent, wire, protocol.decode(payload)[0])
        except ProtocolError as error:
            return SeenFrame(t, self._sent, wire, None, str(error))


class Monitor:
    """One line that is looked at. All times are seconds of one monotonic clock.

    Feed it `opened`, `closed` and every byte received; write what `tick` returns. `settings` are read as soon
    as the firmware has answered.
    """

    def __init__(self, settings: SettingsTalk | None = None) -> None:
        self.session = HostSession()
        self.answer = Answer()
        self._settings = settings
        self._codec = Codec()
        self._traffic = Traffic()
        self._from_device, self._to_device = Tap(sent=False), Tap(sent=True)

    def opened(self, t: float) -> None:
        self._codec.restart()
        self._from_device = Tap(sent=False)
        self.session.opened(t)
        self.answer.opened(t)
        self._traffic.opened()

    def closed(self, t: float) -> None:
        self.session.closed(t)
        self.answer.closed()

    def receive(self, t: float, data: bytes) -> tuple[list[SeenFrame], list[HostEvent]]:
        """What came, and what it means."""
        messages = self._codec.decode(data)
        self._traffic.received(t, data)
        self.answer.received(data, messages)
        events = [event for message in messages for event in self.session.receive(t, message)]
        if self._settings is not None:
            for message in messages:
                self._settings.receive(message)
        return self._from_device.read(t, data), events

    def tick(self, t: float) -> tuple[bytes, list[SeenFrame]]:
        """The bytes to be written at `t`, and what they are."""
        due: list[HostMessage] = [message for message in self.session.tick(t) if isinstance(message, _SAID)]
        if self._settings is not None and self.session.state is SessionState.READY:
            due += self._settings.due(t)
        data = b"".join(FRAME_END + self._codec.encode(message) for message in due)
        self._traffic.written(t, data)
        return data, self._to_device.read(t, data)

    def statistics(self, t: float, dropped_bytes: int) -> LinkStatistics:
        return self._traffic.statistics(t, self._codec, self.session, dropped_bytes)
