"""Notifies systemd: the service is ready, its loop runs, its status has changed, it stops.

The service's loop sends the notifications. If the loop hangs, systemd's watchdog restarts the service.
Nothing is sent if systemd did not start the service.
"""

from __future__ import annotations

import math
import os
import socket
from collections.abc import MutableMapping

from flying_vines.core.events import Event, Stop, Tick
from flying_vines.core.snapshot import Snapshot
from flying_vines.core.watcher import Watcher

PER_WATCHDOG = 4
"""Messages in each watchdog time. So one or two of them may be late."""
STATUS_S = 1.0


def service_manager(environment: MutableMapping[str, str] = os.environ) -> tuple[Watcher, ...]:
    """The service manager that started us, if any. Hides its address from our child processes."""
    address = environment.pop("NOTIFY_SOCKET", "")
    told = environment.pop("WATCHDOG_USEC", "")
    watchdog_us = float(told) if told.isdecimal() else math.inf
    if environment.pop("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        watchdog_us = math.inf
    return (ServiceManager(address, watchdog_us / 1e6),) if address else ()


class ServiceManager(Watcher):
    """Sends datagrams without waiting. READY and WATCHDOG are sent again at each tick until accepted."""

    def __init__(self, address: str, watchdog_s: float) -> None:
        # The name of an abstract socket begins with a zero byte; the environment has @ instead.
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._every_s = watchdog_s / PER_WATCHDOG
        self._ready = False
        self._alive_at = -math.inf
        self._status = ""
        self._status_at = -math.inf

    def event(self, event: Event) -> None:
        match event:
            case Tick(t) if t - self._alive_at >= self._every_s or not self._ready:
                if self._send("WATCHDOG=1" if self._ready else "READY=1"):
                    self._ready, self._alive_at = True, t
            case Stop():
                self._send("STOPPING=1")

    def snapshot(self, snapshot: Snapshot) -> None:
        status = status_line(snapshot)
        news = status != self._status and snapshot.t - self._status_at >= STATUS_S
        if news and self._send(f"STATUS={status}"):
            self._status, self._status_at = status, snapshot.t

    def _send(self, message: str) -> bool:
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as ours:
                ours.sendto(message.encode(), self._address)
        except OSError:
            return False
        return True


def status_line(snapshot: Snapshot) -> str:
    """The status line in `systemctl status`."""
    parts = [
        f"vehicle {snapshot.vehicle}" + (" armed" if snapshot.armed else ""),
        f"RC {snapshot.rc}",
        f"{snapshot.actuator} {snapshot.firmware}",
    ]
    if math.isfinite(snapshot.reservoir_kPa):
        parts.append(f"reservoir {snapshot.reservoir_kPa:.0f} kPa")
    if snapshot.safe_state:
        parts.append(f"SAFE: {', '.join(snapshot.safe_state.values())}")
    parts.extend(snapshot.unstable.values())
    # Texts from board or vehicle must not add lines.
    return " ".join("; ".join([*parts, snapshot.doing]).split())
