"""The host's session with the firmware: a pure state machine without port and clock.

After any interruption (a closed port, a restarted firmware, a refusal) the session vents. Only a new command
ends the vent: the hardware must not resume an old command.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from firmware_link.device_clock import FULL_MS, ClockVerdict, DeviceClock
from firmware_link.protocol import (
    PROTOCOL_VERSION,
    ClearFaults,
    Fault,
    Hello,
    HostMessage,
    Message,
    Ping,
    Pong,
    Refusal,
    RefusalReason,
    Setpoint,
    Telemetry,
    Units,
    Vent,
    Welcome,
)


class SessionState(Enum):
    """The state of the session."""

    CLOSED = "closed"
    """The port is closed."""
    GREETING = "greeting"
    """The port is open. No firmware with our protocol has answered yet."""
    READY = "ready"
    """Commands are repeated and telemetry is used."""
    INCOMPATIBLE = "incompatible"
    """The firmware that answered must not be commanded. Greeting continues: new firmware may be flashed."""


@dataclass(frozen=True, slots=True)
class Regulate:
    """A command: go to `target_kPa` at `rate_kPa_per_s` or slower.

    Raises ValueError if a value is not a number or absurdly large, if the rate is not positive, or if the
    time-to-live is outside 1…65535. The firmware checks the limits of the rig.
    """

    target_kPa: float
    rate_kPa_per_s: float
    ttl_ms: int = 250

    def __post_init__(self) -> None:
        if not abs(self.target_kPa) <= _ABSURD:
            raise ValueError(f"target {self.target_kPa} kPa is not a pressure")
        if not 0 < self.rate_kPa_per_s <= _ABSURD:
            raise ValueError(f"rate {self.rate_kPa_per_s} kPa/s is not a positive rate")
        if not 1 <= self.ttl_ms <= 0xFFFF:
            raise ValueError(f"time-to-live {self.ttl_ms} ms is not within 1…65535")


@dataclass(frozen=True, slots=True)
class Venting:
    """A command: inflation valve closed, solenoid open."""


VENTING = Venting()
HostCommand = Regulate | Venting


@dataclass(frozen=True, slots=True)
class Ready:
    """The handshake is done. The session vents until the next command."""

    welcome: Welcome


@dataclass(frozen=True, slots=True)
class FirmwareReset:
    """The firmware restarted. The command is dropped. `Ready` follows once the new handshake is done."""

    reason: str


@dataclass(frozen=True, slots=True)
class Incompatible:
    """This host must not command the firmware; `reason` is a sentence for people."""

    reason: str


@dataclass(frozen=True, slots=True)
class TelemetryReceived:
    """Telemetry of a READY session with plausible pressures."""

    telemetry: Telemetry


@dataclass(frozen=True, slots=True)
class ImplausibleTelemetry:
    """Too many messages had an implausible pressure: see `HostSession.implausible`."""


@dataclass(frozen=True, slots=True)
class CommandRefused:
    """The firmware refused a command. If it was the current one, the session vents from now on."""

    refusal: Refusal


HostEvent = Ready | FirmwareReset | Incompatible | TelemetryReceived | ImplausibleTelemetry | CommandRefused

_ABSURD = 1e6
"""kPa and kPa/s. A larger number is a mistake, and may not fit the 32-bit floats of the protocol."""
PLAUSIBLE_KPA = {
    "cv_kPa": (-54.7, 474.7),
    "reservoir_kPa": (-262.6, 2262.6),
    "setpoint_kPa": (-54.7, 474.7),
}
"""Minimum and maximum that the firmware can report with the widest settings of its sensors: the span and
10.625 % of the span beyond each end, plus the zero. A setpoint starts at the vine's pressure, so its range is
the same."""
IMPLAUSIBLE_IN_A_ROW = 2
"""One in 65536 corrupted frames passes the CRC by chance. So a single implausible frame is not a fault."""
IMPLAUSIBLE_OF_TEN = 5
"""So many of the last ten frames are a fault, too: a loose contact, or every second frame."""
_HELLO_PERIOD_S = 0.5
_PING_PERIOD_S = 1.0
_MAX_ROUND_TRIP_S = 5.0
_CLOCK_SAMPLES = 16
_DRIFT_OVER_S = 60.0
"""After this time, 1 ms of resolution of the device's clock is less than 20 ppm of drift."""
_FULL_DEVICE_CLOCK_S = FULL_MS / 1e3
# A call of `tick` that comes slightly early still counts as due. Otherwise a host that calls it every 10 ms
# would repeat its command every 30 ms instead of every 20 ms.
_EARLY_S = 1e-4


class _ClockSample(NamedTuple):
    """The result of one ping. Samples sort by round trip: the shortest is the most precise."""

    round_trip_s: float
    at_s: float
    offset_s: float


class _Every:
    """A periodic timer that does not catch up in bursts."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._due_s = -math.inf

    def now(self) -> None:
        self._due_s = -math.inf

    def start(self, t: float) -> None:
        self._due_s = t + self._period_s

    def due(self, t: float) -> bool:
        if t < self._due_s - _EARLY_S:
            return False
        following = self._due_s + self._period_s
        self._due_s = following if following > t else t + self._period_s
        return True


class HostSession:
    """The session with one firmware. All times are seconds of one monotonic clock, not negative.

    Call `opened`, `closed`, `receive` for every message, and `tick` at least every `repeat_s`. Send the
    messages that `tick`, `command` and `clear_faults` return, in order. No received message makes it raise.
    """

    def __init__(self, repeat_s: float = 0.02, first_nonce: int = 1) -> None:
        self.state = SessionState.CLOSED
        self.welcome: Welcome | None = None
        """The firmware's answer in the latest successful handshake."""
        self.telemetry: Telemetry | None = None
        """The latest telemetry since the port was opened."""
        self.telemetry_gaps = 0
        """The number of telemetry frames that are missing or implausible."""
        self.implausible: tuple[str, float] | None = None
        """Field and value of the latest implausible pressure, while too many frames have one; else None."""
        self._recent_implausible: deque[bool] = deque(maxlen=10)
        self.round_trip_s: float | None = None
        """Round trip of the latest ping."""
        self.clock_offset_s: float | None = None
        """Device clock minus host clock, from the recent ping with the shortest round trip. The error is at
        most half of that round trip plus 1 ms."""
        self.clock_drift_ppm: float | None = None
        """How much faster the device's clock runs than ours. Unknown for 60 to 90 s after the handshake."""
        self._hello = _Every(_HELLO_PERIOD_S)
        self._repeat = _Every(repeat_s)
        self._ping = _Every(_PING_PERIOD_S)
        self._nonce = (first_nonce - 1) & 0xFFFFFFFF
        self._number = 0
        self._command: HostCommand = VENTING
        self._first_vent_due = True
        self._telemetry_s: float | None = None
        self._device_clock = DeviceClock()
        self._ready_s = 0.0
        self._clock: deque[_ClockSample] = deque(maxlen=_CLOCK_SAMPLES)
        self._first_clock: _ClockSample | None = None
        self._reported: set[RefusalReason] = set()
        self._incompatible_because: str | None = None

    @property
    def number(self) -> int:
        """Number of the current command. If telemetry has the same number, the firmware has accepted it."""
        return self._number

    def telemetry_age(self, t: float) -> float:
        """Age of the latest telemetry in seconds, by the board's clock; infinite without telemetry."""
        return math.inf if self._telemetry_s is None else t - self._telemetry_s

    def opened(self, t: float) -> None:
        self.telemetry = None
        self._telemetry_s = None
        self._incompatible_because = None
        self._greet()

    def closed(self, t: float) -> None:
        self._forget_command()
        self.state = SessionState.CLOSED

    def command(self, t: float, command: HostCommand) -> list[HostMessage]:
        """Repeat `command` from now on. Send the returned messages at once.

        While not READY the command is dropped: give it again when READY. A command equal to the current one
        changes nothing.
        """
        if self.state is not SessionState.READY:
            return []
        first = self._take_first_vent()
        if command == self._command:
            return first
        self._set_command(command)
        self._repeat.start(t)
        return [*first, self._current_message()]

    def clear_faults(self, t: float, mask: Fault) -> list[HostMessage]:
        """Request to unlatch the faults in `mask`; empty while not READY. A vent continues."""
        return [ClearFaults(int(mask) & 0xFFFF)] if self.state is SessionState.READY else []

    def tick(self, t: float) -> list[HostMessage]:
        if self.state is SessionState.CLOSED:
            return []
        if self.state is not SessionState.READY:
            return [Hello(PROTOCOL_VERSION, self._nonce)] if self._hello.due(t) else []
        due: list[HostMessage] = []
        if self._repeat.due(t):
            due = self._take_first_vent() or [self._current_message()]
        if self._ping.due(t):
            due.append(Ping(round(t * 1e6)))
        return due

    def receive(self, t: float, message: Message) -> list[HostEvent]:
        """The events that follow from a message of the firmware. A host's message (an echo) is ignored."""
        if self.state is SessionState.CLOSED:
            return []
        match message:
            case Welcome():
                return self._on_welcome(t, message)
            case Telemetry():
                return self._on_telemetry(t, message)
            case Refusal():
                return self._on_refusal(message)
            case Pong():
                self._on_pong(t, message)
        return []

    def _on_welcome(self, t: float, welcome: Welcome) -> list[HostEvent]:
        if welcome.nonce != self._nonce:
            return []
        if self.state is SessionState.READY:
            if self.welcome is not None and welcome.boot_id == self.welcome.boot_id:
                return []
            return self._reset("it answered with another boot id")
        reason = _why_incompatible(welcome)
        if reason is not None:
            return self._incompatible(reason)
        events: list[HostEvent] = []
        if self.welcome is not None and self.welcome.boot_id != welcome.boot_id:
            events.append(FirmwareReset("it has another boot id than before"))
        self.welcome = welcome
        self.state = SessionState.READY
        self._ready_s = t
        self._repeat.now()
        self._ping.now()
        return [*events, Ready(welcome)]

    def _on_telemetry(self, t: float, telemetry: Telemetry) -> list[HostEvent]:
        # Before the handshake these bytes may be another version's telemetry.
        if self.state is not SessionState.READY:
            return []
        match self._device_clock.take(t, telemetry.device_time_ms):
            case ClockVerdict.OLD:
                return []
            case ClockVerdict.LEAPT:
                self.telemetry_gaps += 1
                return []
            case ClockVerdict.BACK:
                return self._reset(f"its clock went back to {telemetry.device_time_ms} ms")
        if self.welcome is not None:
            periods = self._device_clock.passed_ms * self.welcome.telemetry_Hz / 1000
            self.telemetry_gaps += max(0, round(periods) - 1)
        recent = self._recent_implausible
        if (found := _implausible(telemetry)) is not None:
            self.telemetry_gaps += 1
            recent.append(True)
            in_a_row = list(recent)[-IMPLAUSIBLE_IN_A_ROW:].count(True) == IMPLAUSIBLE_IN_A_ROW
            if not in_a_row and sum(recent) < IMPLAUSIBLE_OF_TEN:
                return []
            begun, self.implausible = self.implausible is None, found
            return [ImplausibleTelemetry()] if begun else []
        recent.append(False)
        if self.implausible is not None and sum(recent) < IMPLAUSIBLE_OF_TEN:
            self.implausible = None
        self.telemetry = telemetry
        self._telemetry_s = t - self._device_clock.behind_s
        return [TelemetryReceived(telemetry)]

    def _on_refusal(self, refusal: Refusal) -> list[HostEvent]:
        if refusal.reason is RefusalReason.VERSION and self.state is not SessionState.READY:
            if self.state is SessionState.INCOMPATIBLE:
                return []
            return self._incompatible(f"The firmware does not speak protocol version {PROTOCOL_VERSION}.")
        if self.state is not SessionState.READY:
            return []
        if refusal.reason in (RefusalReason.NO_HANDSHAKE, RefusalReason.VERSION):
            return self._reset("it has lost this session")
        if refusal.reason is RefusalReason.OVERTAKEN:
            # For an old command this refusal is normal.
            current = isinstance(self._command, Regulate) and refusal.number == self._number
            return self._reset("it has received newer commands than ours") if current else []
        if isinstance(self._command, Regulate) and refusal.number == self._number:
            self._set_command(VENTING)
            self._repeat.now()
        # Repeats of a refused command are refused as well, and so may be those of another program.
        elif refusal.reason in self._reported:
            return []
        self._reported.add(refusal.reason)
        return [CommandRefused(refusal)]

    def _on_pong(self, t: float, pong: Pong) -> None:
        sent_s = pong.host_time_us / 1e6
        round_trip_s = t - sent_s
        # Rounding to microseconds may make the round trip of an instant answer negative.
        if self.state is not SessionState.READY or not -1e-6 <= round_trip_s <= _MAX_ROUND_TRIP_S:
            return
        if sent_s < self._ready_s - 1e-6:
            return
        self.round_trip_s = max(0.0, round_trip_s)
        middle_s = (sent_s + t) / 2
        offset_s = pong.device_time_ms / 1e3 - middle_s
        if self.clock_offset_s is not None:
            # The device's clock wraps; the offset does not.
            wraps = round((self.clock_offset_s - offset_s) / _FULL_DEVICE_CLOCK_S)
            offset_s += wraps * _FULL_DEVICE_CLOCK_S
        self._clock.append(_ClockSample(self.round_trip_s, middle_s, offset_s))
        best = min(self._clock)
        self.clock_offset_s = best.offset_s
        if len(self._clock) == _CLOCK_SAMPLES:
            self._first_clock = first = self._first_clock or best
            passed_s = best.at_s - first.at_s
            if passed_s >= _DRIFT_OVER_S:
                self.clock_drift_ppm = 1e6 * (best.offset_s - first.offset_s) / passed_s

    def _reset(self, reason: str) -> list[HostEvent]:
        self._greet()
        return [FirmwareReset(reason)]

    def _incompatible(self, reason: str) -> list[HostEvent]:
        self.state = SessionState.INCOMPATIBLE
        if reason == self._incompatible_because:
            return []
        self._incompatible_because = reason
        return [Incompatible(reason)]

    def _greet(self) -> None:
        self._forget_command()
        self.state = SessionState.GREETING
        self._nonce = (self._nonce + 1) & 0xFFFFFFFF
        self._hello.now()
        self._device_clock.restart()
        self._recent_implausible.clear()
        self.implausible = None
        self._clock.clear()
        self._first_clock = None
        self.round_trip_s = None
        self.clock_offset_s = None
        self.clock_drift_ppm = None

    def _forget_command(self) -> None:
        self._command = VENTING
        self._first_vent_due = True
        self._reported.clear()

    def _take_first_vent(self) -> list[HostMessage]:
        """The vent that every session sends first, once."""
        if not self._first_vent_due:
            return []
        self._first_vent_due = False
        self._set_command(VENTING)
        return [self._current_message()]

    def _set_command(self, command: HostCommand) -> None:
        self._command = command
        # 0 is reserved: telemetry has it before the first command.
        self._number = self._number % 0xFFFF + 1

    def _current_message(self) -> HostMessage:
        command = self._command
        if isinstance(command, Regulate):
            return Setpoint(command.target_kPa, command.rate_kPa_per_s, command.ttl_ms, self._number)
        return Vent(self._number)


def _implausible(telemetry: Telemetry) -> tuple[str, float] | None:
    """Field and value of the first implausible pressure, or None. NaN is implausible."""
    for field, (min_kPa, max_kPa) in PLAUSIBLE_KPA.items():
        value: float = getattr(telemetry, field)
        if not min_kPa <= value <= max_kPa:
            return field, value
    return None


def _why_incompatible(welcome: Welcome) -> str | None:
    """Why this host must not command the firmware; None if it may."""
    who = f"The firmware {welcome.firmware_build!r}"
    if welcome.protocol_version != PROTOCOL_VERSION:
        return (
            f"{who} speaks protocol version {welcome.protocol_version}, this host speaks {PROTOCOL_VERSION}: "
            f"update the {'host' if welcome.protocol_version > PROTOCOL_VERSION else 'firmware'}."
        )
    if welcome.units != Units.KPA_GAUGE:
        return f"{who} uses units of code {welcome.units}, not kPa gauge (1)."
    limits = (
        welcome.cv_limit_kPa,
        welcome.setpoint_limit_kPa,
        welcome.reservoir_limit_kPa,
        welcome.rate_limit_kPa_per_s,
    )
    if not all(math.isfinite(limit) and limit > 0 for limit in limits):
        return f"{who} reports limits that are not positive numbers: {limits}."
    if welcome.dead_man_ms == 0 or welcome.telemetry_Hz == 0:
        return f"{who} has no dead-man or no telemetry."
    return None
