"""The host side of the link, ready to use: a port, the codec and the session."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable

from firmware_link.host import VENTING, Command, HostEvent, HostSession
from firmware_link.protocol import Codec, Fault, HostMessage
from firmware_link.serial_port import SerialPort

_TICK_S = 0.01


class FirmwareLink:
    """Talks to the firmware at `path`, reconnecting for as long as `run` runs.

    Events arrive on `on_event`, the port's coming and going (with the reason) on `on_state`; both are
    called from the event loop. When `run` is cancelled the actuator is vented. Example:

        async def bend() -> None:
            def on_event(event: HostEvent) -> None:
                match event:
                    case Ready():
                        link.command(Regulate(target_kPa=15.0, rate_kPa_per_s=20.0))
                    case TelemetryReceived(telemetry):
                        print(telemetry.cv_kPa)

            link = FirmwareLink("/dev/ttyACM0", on_event)
            await link.run()

        asyncio.run(bend())
    """

    def __init__(
        self,
        path: str,
        on_event: Callable[[HostEvent], None],
        on_state: Callable[[bool, str], None] = lambda up, why: None,
        baud: int = 115200,
    ) -> None:
        self.session = HostSession()
        self.codec = Codec()
        self.port = SerialPort(path, baud, self._received, self._state_changed)
        self._on_event = on_event
        self._on_state = on_state

    def command(self, command: Command) -> None:
        """From now on hold `command`; forgotten while the session is not READY."""
        self._send(self.session.command(time.monotonic(), command))

    def clear_faults(self, mask: Fault) -> None:
        """Ask the firmware to unlatch the faults in `mask` that are over."""
        self._send(self.session.clear_faults(time.monotonic(), mask))

    async def run(self) -> None:
        """Until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self.port.run())
            try:
                while True:
                    self._send(self.session.tick(time.monotonic()))
                    await asyncio.sleep(_TICK_S)
            finally:
                self.command(VENTING)

    def _received(self, data: bytes) -> None:
        for message in self.codec.decode(data):
            for event in self.session.receive(time.monotonic(), message):
                self._on_event(event)

    def _state_changed(self, up: bool, why: str) -> None:
        if up:
            self.codec.restart()
            self.session.opened(time.monotonic())
        else:
            self.session.closed(time.monotonic())
        self._on_state(up, why)

    def _send(self, messages: Iterable[HostMessage]) -> None:
        for message in messages:
            self.port.write(self.codec.encode(message))
