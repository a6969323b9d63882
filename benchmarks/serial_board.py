"""The firmware's end of the serial line on a pseudo-terminal: it answers, reports, and notices setpoints."""

from __future__ import annotations

import contextlib
import os
import tty
from types import TracebackType
from typing import Self

from firmware_link.protocol import (
    PROTOCOL_VERSION,
    Codec,
    DeviceMessage,
    Fault,
    Hello,
    Mode,
    Ping,
    Pong,
    Setpoint,
    Telemetry,
    Units,
    Vent,
    Welcome,
)

TELEMETRY_HZ = 100
FULL_KPA = 690.0
CV_NOISE_KPA, RESERVOIR_NOISE_KPA = 0.15, 1.2
MOVED_KPA = 0.05
"""A smaller change of the target does not count: floats on the wire are rounded."""


class SerialBoard:
    """A board whose vine is always at the last setpoint, and whose reservoir never empties."""

    def __init__(self, began_s: float) -> None:
        self.received = False
        """True after the first frame of the host."""
        self.telemetry_frames = 0
        self.dropped_bytes = 0
        self._began_s = began_s
        self._codec = Codec()
        self._mode = Mode.VENT
        self._number = 0
        self._target_kPa = 0.0
        self.fd, self._hosts_fd = os.openpty()
        tty.setraw(self._hosts_fd)
        os.set_blocking(self.fd, False)
        self.path = os.ttyname(self._hosts_fd)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self.fd)
        os.close(self._hosts_fd)

    def receive(self, now_s: float, data: bytes) -> bool:
        """Read the host's bytes. Returns true if they contain a setpoint with a new target."""
        moved = False
        for message in self._codec.decode(data):
            self.received = True
            match message:
                case Setpoint(target_kPa, _, _, number):
                    moved = moved or abs(target_kPa - self._target_kPa) > MOVED_KPA
                    self._mode, self._target_kPa, self._number = Mode.REGULATE, target_kPa, number
                case Vent(number):
                    self._mode, self._target_kPa, self._number = Mode.VENT, 0.0, number
                case Hello(_, nonce):
                    self._send(_welcome(nonce))
                case Ping(host_time_us):
                    self._send(Pong(host_time_us, self._time_ms(now_s)))
        return moved

    def report(self, now_s: float) -> None:
        """Send telemetry."""
        regulating = self._mode is Mode.REGULATE
        self.telemetry_frames += 1
        # With constant readings the service would report a stuck sensor.
        noise = 1.0 if self.telemetry_frames % 2 else -1.0
        self._send(
            Telemetry(
                device_time_ms=self._time_ms(now_s),
                mode=self._mode,
                faults=Fault.NONE,
                number=self._number,
                setpoint_kPa=self._target_kPa,
                cv_kPa=self._target_kPa + noise * CV_NOISE_KPA,
                reservoir_kPa=FULL_KPA + noise * RESERVOIR_NOISE_KPA,
                evp_opening=0.3 if regulating else 0.0,
                dvp_opening=0.0,
                solenoid=not regulating,
            )
        )

    def _time_ms(self, now_s: float) -> int:
        return int(1e3 * (now_s - self._began_s)) + 1000

    def _send(self, message: DeviceMessage) -> None:
        frame = self._codec.encode(message)
        written = 0
        # A host that does not read (the peers do not) must not stop the measurement.
        with contextlib.suppress(BlockingIOError):
            written = os.write(self.fd, frame)
        self.dropped_bytes += len(frame) - written


def _welcome(nonce: int) -> Welcome:
    return Welcome(
        protocol_version=PROTOCOL_VERSION,
        nonce=nonce,
        boot_id=7,
        firmware_build="benchmark",
        units=Units.KPA_GAUGE,
        cv_limit_kPa=30.0,
        setpoint_limit_kPa=28.0,
        reservoir_limit_kPa=760.0,
        rate_limit_kPa_per_s=200.0,
        dead_man_ms=300,
        telemetry_Hz=TELEMETRY_HZ,
    )
