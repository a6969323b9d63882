"""Actuators that are not a phloSAR: the interface of a device, and its line to the host's session."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Protocol

from firmware_link.framing import FRAME_END
from firmware_link.protocol import (
    PROTOCOL_VERSION,
    Codec,
    Fault,
    Hello,
    HostMessage,
    Message,
    Mode,
    Setpoint,
    Telemetry,
    Units,
    Vent,
    Welcome,
    encode,
)

BOOT_ID = 1
"""An actuator has no boot id, so this one never changes. After a restart the actuator reports that it is
vented."""
_CLOCK_MS = 1 << 32


class Line(Protocol):
    """Bytes of one device <-> messages of the host's session. It opens no port and reads no clock."""

    vent: bytes
    """Vents the device in any state. It is also sent after an error."""

    def restart(self) -> None:
        """The port was opened again: forget incomplete messages."""

    def encode(self, message: HostMessage) -> bytes:
        """The bytes for the device; empty if the device has no such message."""

    def decode(self, t: float, data: bytes) -> list[Message]:
        """The messages that end within `data`, which came at `t` (seconds)."""


class PhlosarLine:
    """The line to a phloSAR: its own protocol."""

    vent = FRAME_END + encode(Vent(1), 0)  # the firmware accepts a vent with any number

    def __init__(self) -> None:
        self._codec = Codec()
        self.restart = self._codec.restart

    def encode(self, message: HostMessage) -> bytes:
        # FRAME_END first: an incomplete frame on the line must not damage ours.
        return FRAME_END + self._codec.encode(message)

    def decode(self, t: float, data: bytes) -> list[Message]:
        return self._codec.decode(data)


@dataclass(frozen=True, slots=True)
class Reading:
    """A report of the device. Each value must come from the device, not from the host."""

    pressure_kPa: float
    """Measured, gauge. NaN: the sensor has failed."""
    vented: bool
    """The device drives nothing and its outlet is open."""
    faults: Fault = Fault.NONE
    """The faults for which the device vents by itself."""


class Actuator(Protocol):
    """A device that bends the vine. `conformance.broken_promises` checks the promises.

    The device itself, not this class, must vent if nothing comes for `dead_man_ms`, after a reset, and
    without power: this computer may stop at any time. It must send reports also while it is vented.
    """

    name: str
    """The device's name, for people: printable ASCII, at most 16 characters."""
    max_kPa: float
    max_rate_kPa_per_s: float
    dead_man_ms: int
    """At most 250."""
    reports_Hz: int
    """At least 10."""
    vent: bytes
    """Vents the device in any state. Read only once, so that a later error cannot prevent a vent."""

    def setpoint(self, kPa: float) -> bytes:
        """Called every 20 ms while the vine bends, with 0…`max_kPa` (gauge)."""

    def readings(self, data: bytes) -> Iterable[Reading]:
        """The readings that end within `data`, a piece of the stream of any length.

        An incomplete reading waits for the rest.
        """


class ActuatorLine:
    """The line to an `Actuator`.

    Raises ValueError with one sentence if a number or `vent` breaks the actuator's promises, and
    MalformedMessageError if the name does.
    """

    def __init__(self, actuator: Actuator) -> None:
        self._actuator = actuator
        self.vent = bytes(actuator.vent)
        if not self.vent:
            raise ValueError("vent is empty")
        if not 1 <= actuator.dead_man_ms <= 250:
            raise ValueError(f"dead_man_ms is {actuator.dead_man_ms}, not 1…250")
        if not 10 <= actuator.reports_Hz <= 1000:
            raise ValueError(f"reports_Hz is {actuator.reports_Hz}, not 10…1000")
        if not (0.0 < actuator.max_kPa <= 400.0 and 0.0 < actuator.max_rate_kPa_per_s <= 2000.0):
            raise ValueError("max_kPa must be within 0…400, and max_rate_kPa_per_s within 0…2000")
        self._limit_kPa = actuator.max_kPa
        self._welcome = Welcome(
            protocol_version=PROTOCOL_VERSION,
            nonce=0,
            boot_id=BOOT_ID,
            firmware_build=actuator.name,
            units=Units.KPA_GAUGE,
            cv_limit_kPa=self._limit_kPa,
            setpoint_limit_kPa=self._limit_kPa,
            reservoir_limit_kPa=self._limit_kPa,
            rate_limit_kPa_per_s=actuator.max_rate_kPa_per_s,
            dead_man_ms=actuator.dead_man_ms,
            telemetry_Hz=actuator.reports_Hz,
        )
        self._welcome.pack()  # raises an error for a name that the protocol does not allow
        self.restart()

    def restart(self) -> None:
        self._nonce: int | None = None
        """The nonce of a greeting that is not answered yet."""
        self._number = 0
        self._setpoint_kPa = 0.0

    def encode(self, message: HostMessage) -> bytes:
        match message:
            case Hello(nonce=nonce):
                self._nonce = nonce
                return self.vent
            case Vent(number):
                self._number, self._setpoint_kPa = number, 0.0
                return self.vent
            case Setpoint(target_kPa, number=number):
                self._number = number
                self._setpoint_kPa = min(max(0.0, target_kPa), self._limit_kPa)
                return bytes(memoryview(self._actuator.setpoint(self._setpoint_kPa)))
        return b""

    def decode(self, t: float, data: bytes) -> list[Message]:
        """Readings that come together have one time, so only the last one is passed on, with all faults."""
        readings = list(self._actuator.readings(data))
        if not readings:
            return []
        last, faults = readings[-1], Fault.NONE
        for reading in readings:
            faults |= Fault(reading.faults)
        messages: list[Message] = []
        if self._nonce is not None:
            # A report proves that the device is connected.
            messages.append(replace(self._welcome, nonce=self._nonce))
            self._nonce = None
        mode = Mode.FAULT if faults else Mode.VENT if last.vented else Mode.REGULATE
        messages.append(
            Telemetry(
                device_time_ms=int(t * 1000.0) % _CLOCK_MS,
                mode=mode,
                faults=faults,
                number=self._number,
                setpoint_kPa=self._setpoint_kPa if mode is Mode.REGULATE else 0.0,
                cv_kPa=float(last.pressure_kPa),
                reservoir_kPa=0.0,
                evp_opening=0.0,
                dvp_opening=0.0,
                solenoid=mode is not Mode.REGULATE,
            )
        )
        return messages
