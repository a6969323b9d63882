"""The complete host side of the link: port, codec and session."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable

from firmware_link.answer_check import AnswerCheck
from firmware_link.find import Ports, UsbBoard
from firmware_link.framing import FRAME_END
from firmware_link.host import VENTING, HostCommand, HostEvent, HostSession
from firmware_link.protocol import Codec, Fault, HostMessage
from firmware_link.serial_port import SerialPort
from firmware_link.statistics import LinkStatistics, Traffic

_TICK_S = 0.01


class FirmwareLink:
    """Communicates with the firmware at `where`, a port or a board. `run` reconnects after every loss.

    `on_event` gets the events. `on_state(up, why)` is called when the port opens or closes, when the firmware
    does not answer on it, and when it answers again. Both functions are called from the event loop. When
    `run` is cancelled, it vents the actuator. Example:

        async def bend() -> None:
            def on_event(event: HostEvent) -> None:
                match event:
                    case Ready():
                        link.command(Regulate(target_kPa=15.0, rate_kPa_per_s=20.0))
                    case TelemetryReceived(telemetry):
                        print(telemetry.cv_kPa)

            link = FirmwareLink(UsbBoard.parse("usb:16c0:0483"), on_event)
            await link.run()

        asyncio.run(bend())
    """

    def __init__(
        self,
        where: str | UsbBoard,
        on_event: Callable[[HostEvent], None],
        on_state: Callable[[bool, str], None] = lambda up, why: None,
        baud: int = 115200,
        ports: Ports | None = None,
    ) -> None:
        self.session = HostSession()
        self.codec = Codec()
        self.port = SerialPort(where, baud, self._received, self._state_changed, ports)
        self._traffic = Traffic()
        self._answer_check = AnswerCheck()
        self._on_event = on_event
        self._on_state = on_state

    @property
    def statistics(self) -> LinkStatistics:
        return self._traffic.statistics(time.monotonic(), self.codec, self.session, self.port.dropped_bytes)

    def command(self, command: HostCommand) -> None:
        """Repeat `command` from now on. It is dropped while the session is not READY."""
        self._send(self.session.command(time.monotonic(), command))

    def clear_faults(self, mask: Fault) -> None:
        """Request the firmware to unlatch the faults in `mask` that are no longer present."""
        self._send(self.session.clear_faults(time.monotonic(), mask))

    async def run(self) -> None:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self.port.run())
            try:
                while True:
                    now = time.monotonic()
                    self._send(self.session.tick(now))
                    self._report_silence(now)
                    await asyncio.sleep(_TICK_S)
            finally:
                self.command(VENTING)

    def _received(self, data: bytes) -> None:
        messages = self.codec.decode(data)
        self._traffic.received(time.monotonic(), data)
        self._answer_check.received(data, messages)
        for message in messages:
            for event in self.session.receive(time.monotonic(), message):
                self._on_event(event)

    def _state_changed(self, up: bool, why: str) -> None:
        if up:
            self.codec.restart()
            self.session.opened(time.monotonic())
            self._traffic.opened()
            self._answer_check.opened(time.monotonic())
        else:
            self.session.closed(time.monotonic())
            self._answer_check.closed()
        self._on_state(up, why)

    def _report_silence(self, t: float) -> None:
        problem = self._answer_check.news(t)
        if problem is not None:
            self._on_state(True, problem or "the firmware answers")

    def _send(self, messages: Iterable[HostMessage]) -> None:
        for message in messages:
            # End any incomplete frame on the line, so that it does not damage ours.
            data = FRAME_END + self.codec.encode(message)
            self._traffic.written(time.monotonic(), data)
            self.port.write(data)
