"""A host that only monitors: it greets, requests the time, and shows every frame on the line.

It sends no setpoint. Its greeting ends any regulation, so the vine vents. With `settings` it also reads and
changes the firmware's settings. No other program can have the port open at the same time.
"""

from __future__ import annotations

from typing import NamedTuple

from firmware_link import protocol
from firmware_link.answer_check import AnswerCheck
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
from firmware_link.settings import SettingsExchange
from firmware_link.statistics import LinkStatistics, Traffic

_ALLOWED = (Hello, Ping, GetSetting, SetSetting)
"""The only messages that a monitor sends."""


class SeenFrame(NamedTuple):
    """One frame, or bytes that are not a valid frame."""

    t: float
    sent: bool
    """True: sent by us; False: by the device."""
    wire: bytes
    """The bytes on the line, without the final zero byte."""
    message: Message | None
    problem: str = ""
    """Why it is not a message; empty if it is one."""


class Tap:
    """Splits the bytes of one direction into frames. Never raises."""

    def __init__(self, sent: bool) -> None:
        self._sent = sent
        self._frames = FrameDecoder()

    def read(self, t: float, data: bytes) -> list[SeenFrame]:
        """The frames that end within `data`."""
        return [self._seen(t, wire, payload) for wire, payload in self._frames.frames(data)]

    def _seen(self, t: float, wire: bytes, payload: bytes | None) -> SeenFrame:
        if payload is None:
            return SeenFrame(t, self._sent, wire, None, "not a frame, or a damaged one")
        try:
            return SeenFrame(t, self._sent, wire, protocol.decode(payload)[0])
        except ProtocolError as error:
            return SeenFrame(t, self._sent, wire, None, str(error))


class Monitor:
    """Monitors one line. All times are seconds of one monotonic clock.

    Call `opened`, `closed` and `receive`, and write the bytes of `tick`. `settings` are read as soon
    as the firmware has answered.
    """

    def __init__(self, settings: SettingsExchange | None = None) -> None:
        self.session = HostSession()
        self.answer_check = AnswerCheck()
        self._settings = settings
        self._codec = Codec()
        self._traffic = Traffic()
        self._from_device, self._to_device = Tap(sent=False), Tap(sent=True)

    def opened(self, t: float) -> None:
        self._codec.restart()
        self._from_device = Tap(sent=False)
        self.session.opened(t)
        self.answer_check.opened(t)
        self._traffic.opened()

    def closed(self, t: float) -> None:
        self.session.closed(t)
        self.answer_check.closed()

    def receive(self, t: float, data: bytes) -> tuple[list[SeenFrame], list[HostEvent]]:
        """The received frames, and the session's events."""
        messages = self._codec.decode(data)
        self._traffic.received(t, data)
        self.answer_check.received(data, messages)
        events = [event for message in messages for event in self.session.receive(t, message)]
        if self._settings is not None:
            for message in messages:
                self._settings.receive(message)
        return self._from_device.read(t, data), events

    def tick(self, t: float) -> tuple[bytes, list[SeenFrame]]:
        """The bytes to write at `t`, and their frames."""
        due: list[HostMessage] = [
            message for message in self.session.tick(t) if isinstance(message, _ALLOWED)
        ]
        if self._settings is not None and self.session.state is SessionState.READY:
            due += self._settings.due(t)
        data = b"".join(FRAME_END + self._codec.encode(message) for message in due)
        self._traffic.written(t, data)
        return data, self._to_device.read(t, data)

    def statistics(self, t: float, dropped_bytes: int) -> LinkStatistics:
        return self._traffic.statistics(t, self._codec, self.session, dropped_bytes)
