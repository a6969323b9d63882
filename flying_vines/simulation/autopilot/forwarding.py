"""Forwards messages between links: at once on ArduPilot, through a buffer of two messages on PX4."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from flying_vines.simulation.autopilot.port import Port
from flying_vines.simulation.autopilot.scheduler import Scheduler
from flying_vines.vehicle.mission.storage import AutopilotKind

PX4_BUFFER = 2
_PX4_EVERY_S = 0.01


class Forwarder:
    """Sends frames unchanged on other links, if both links take part in forwarding.

    PX4 sends one forwarded message per loop of a link, here every 10 ms as on a slow link. Frames that arrive
    while the link's buffer is full are lost.
    """

    def __init__(self, kind: AutopilotKind, scheduler: Scheduler, send: Callable[[str, bytes], None]) -> None:
        self._kind = kind
        self._scheduler = scheduler
        self._send = send
        self._buffers: dict[str, deque[bytes]] = {}

    def reboot(self) -> None:
        self._buffers.clear()

    def forward(self, source: Port, port: Port, frame: bytes) -> None:
        if not (source.forwards and port.forwards and port.active and port is not source):
            return
        if self._kind == "ardupilot":
            self._send(port.name, frame)
            return
        buffer = self._buffers.setdefault(port.name, deque())
        if len(buffer) < PX4_BUFFER:
            buffer.append(frame)
            if len(buffer) == 1:
                self._scheduler.after(_PX4_EVERY_S, lambda: self._next(port))

    def _next(self, port: Port) -> None:
        buffer = self._buffers[port.name]
        self._send(port.name, buffer.popleft())
        if buffer:
            self._scheduler.after(_PX4_EVERY_S, lambda: self._next(port))
