"""The messages between host and firmware, in both directions. The firmware's copy is `core/messages.cpp`.

A frame's payload is type (u8), sequence (u8, per direction, wraps), body; everything is little-endian.
Pressures are kPa gauge. `docs/serial-protocol.md` describes the same messages. Golden vectors test both
copies.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum, IntFlag
from typing import Any, ClassVar, Self

from firmware_link.framing import FrameDecoder, encode_frame

PROTOCOL_VERSION = 3

# The errors, as a tree:
#
#   LinkError
#   └── ProtocolError
#       ├── UnknownMessageError     a type that this version does not know
#       └── MalformedMessageError   a known type whose length or contents are wrong


class LinkError(Exception):
    """Base of all errors of this package."""


class ProtocolError(LinkError):
    """Bytes that are not a message, or a message that cannot be encoded."""


class UnknownMessageError(ProtocolError):
    """A message type that this protocol version does not know."""


class MalformedMessageError(ProtocolError):
    """A known message type whose length or contents are wrong."""


class Mode(IntEnum):
    """The firmware's mode."""

    VENT = 0
    REGULATE = 1
    FAULT = 2


class Fault(IntFlag):
    """The reasons for which the firmware vents by itself. Each bit latches until `ClearFaults`."""

    NONE = 0
    DEAD_MAN = 1 << 0
    CV_OVERPRESSURE = 1 << 1
    RESERVOIR_OVERPRESSURE = 1 << 2
    CV_SENSOR = 1 << 3
    RESERVOIR_SENSOR = 1 << 4
    WATCHDOG_RESET = 1 << 5
    SETTINGS = 1 << 6
    SUPPLY = 1 << 7
    VENTURI = 1 << 8


_MODES = {int(mode): mode for mode in Mode}
"""A table, because calls of the enumeration would take half of the time to decode telemetry."""


def fault_names(faults: Fault) -> str:
    """The names of the known faults. Unknown bits follow as one hexadecimal number."""
    names = [fault.name or "" for fault in Fault if fault in faults and fault]
    unknown = int(faults) & ~sum(Fault)
    return ", ".join([*names, f"0x{unknown:04X}"] if unknown else names)


class RefusalReason(IntEnum):
    """Why the firmware refused a command."""

    NO_HANDSHAKE = 1
    VERSION = 2
    OUT_OF_RANGE = 3
    FAULT_LATCHED = 4
    NOT_A_NUMBER = 5
    REGULATING = 6
    OVERTAKEN = 7


class Units(IntEnum):
    """The unit of the firmware's pressures."""

    KPA_GAUGE = 1


@dataclass(frozen=True, slots=True)
class _Body:
    """A message's fields, in the order of its layout."""

    TYPE: ClassVar[int]
    LAYOUT: ClassVar[struct.Struct]
    __match_args__: ClassVar[tuple[str, ...]]

    def pack(self) -> bytes:
        """The body's bytes. Raises MalformedMessageError if a value does not fit its field."""
        try:
            return self.LAYOUT.pack(*self._to_wire())
        except (struct.error, OverflowError) as error:
            raise MalformedMessageError(f"{self} does not fit its layout: {error}") from None

    @classmethod
    def unpack(cls, body: bytes) -> Self:
        """The message. Raises MalformedMessageError if the body's length or contents are wrong."""
        if len(body) != cls.LAYOUT.size:
            raise MalformedMessageError(
                f"{cls.__name__} has a body of {cls.LAYOUT.size} bytes, not of {len(body)}"
            )
        return cls._from_wire(cls.LAYOUT.unpack(body))

    def _to_wire(self) -> Sequence[Any]:
        return [getattr(self, name) for name in self.__match_args__]

    @classmethod
    def _from_wire(cls, values: tuple[Any, ...]) -> Self:
        return cls(*values)


@dataclass(frozen=True, slots=True)
class Hello(_Body):
    """Host to device: greeting. Ends any regulation. `Welcome` returns the same `nonce`."""

    TYPE: ClassVar[int] = 0x01
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<BI")

    protocol_version: int
    nonce: int


@dataclass(frozen=True, slots=True)
class Setpoint(_Body):
    """Host to device: regulate to `target_kPa` at `rate_kPa_per_s` or slower, for `ttl_ms`.

    `number` counts the host's commands. Telemetry has the number of the last accepted command. A `Codec`
    fills in `session` and `count`, so that a line that repeats its last bytes holds no dead-man off.
    """

    TYPE: ClassVar[int] = 0x02
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<ffHHII")

    target_kPa: float
    rate_kPa_per_s: float
    ttl_ms: int
    number: int
    session: int = 0
    """From the device's latest `Welcome`."""
    count: int = 0
    """Counts the setpoints of a session, repeats too."""


@dataclass(frozen=True, slots=True)
class Vent(_Body):
    """Host to device: close the inflation valve, and open the solenoid. Always accepted."""

    TYPE: ClassVar[int] = 0x03
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<H")

    number: int


@dataclass(frozen=True, slots=True)
class ClearFaults(_Body):
    """Host to device: unlatch the faults in `mask` that are no longer present."""

    TYPE: ClassVar[int] = 0x04
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<H")

    mask: int


@dataclass(frozen=True, slots=True)
class Ping(_Body):
    """Host to device: measures the round trip and requests the device's time."""

    TYPE: ClassVar[int] = 0x05
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<Q")

    host_time_us: int


@dataclass(frozen=True, slots=True)
class GetSetting(_Body):
    """Host to device: request for setting `id`. Answered by `Setting`; refused if there is no such id."""

    TYPE: ClassVar[int] = 0x06
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<B")

    id: int


@dataclass(frozen=True, slots=True)
class SetSetting(_Body):
    """Host to device: store `value` as setting `id`, permanently. Refused while regulating.

    Answered by `Setting`. The body ends with a fixed number: a second check against a damaged frame whose
    CRC is right by chance.
    """

    TYPE: ClassVar[int] = 0x07
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<BfH")

    id: int
    value: float

    def _to_wire(self) -> Sequence[Any]:
        return (self.id, self.value, _UNLOCK)

    @classmethod
    def _from_wire(cls, values: tuple[Any, ...]) -> Self:
        setting, value, unlock = values
        if unlock != _UNLOCK:
            raise MalformedMessageError(f"SetSetting ends with 0x{unlock:04X}, not with 0x{_UNLOCK:04X}")
        return cls(setting, value)


_UNLOCK = 0x5E77


def _text_to_wire(text: str, size: int, what: str) -> bytes:
    if len(text) > size or not text.isascii() or not (text.isprintable() or not text):
        raise MalformedMessageError(f"{what} {text!r}: use at most {size} printable ASCII characters")
    return text.encode("ascii")


def _text_from_wire(data: bytes, what: str) -> str:
    text = data.rstrip(b"\x00").decode("latin-1")
    if not text.isascii() or not (text.isprintable() or not text):
        raise MalformedMessageError(f"{what} is not printable ASCII")
    return text


class SettingsMemory(IntEnum):
    """What was in the memory of the firmware's settings."""

    NONE = 0
    """The device is no phloSAR and has no settings."""
    STORED = 1
    ERASED = 2
    """The standard settings are used."""
    DAMAGED = 3
    """The standard settings are used, and SETTINGS is latched."""


@dataclass(frozen=True, slots=True)
class Welcome(_Body):
    """Device to host, in answer to `Hello`: the firmware's identity and limits.

    `boot_id` differs after every reset, `session` in every answer. `settings_digest` is the FNV-1a digest of
    all settings as 32-bit floats. Later versions may only append to this message, so that every host
    can read the version of every firmware.
    """

    TYPE: ClassVar[int] = 0x81
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<BII16sBffffHHIIB")

    protocol_version: int
    nonce: int
    boot_id: int
    firmware_build: str
    units: int
    cv_limit_kPa: float
    setpoint_limit_kPa: float
    reservoir_limit_kPa: float
    rate_limit_kPa_per_s: float
    dead_man_ms: int
    telemetry_Hz: int
    session: int = 0
    settings_digest: int = 0
    settings_memory: SettingsMemory = SettingsMemory.NONE

    @classmethod
    def unpack(cls, body: bytes) -> Self:
        """The message. If it is of another protocol version, only the fields that all versions have."""
        if len(body) >= _COMMON_WELCOME_SIZE and body[0] != PROTOCOL_VERSION:
            body = body[:_COMMON_WELCOME_SIZE].ljust(cls.LAYOUT.size, b"\x00")
        # super() without arguments fails here, because slots=True makes a copy of the class.
        return super(Welcome, cls).unpack(body)

    def _to_wire(self) -> Sequence[Any]:
        values = [getattr(self, name) for name in self.__match_args__]
        values[3] = _text_to_wire(self.firmware_build, 16, "firmware build")
        return values

    @classmethod
    def _from_wire(cls, values: tuple[Any, ...]) -> Self:
        build = _text_from_wire(values[3], "Welcome's firmware build")
        try:
            memory = SettingsMemory(values[-1])
        except ValueError:
            raise MalformedMessageError(f"Welcome's memory of settings {values[-1]} is not known") from None
        wire: list[Any] = [*values[:3], build, *values[4:-1], memory]
        return cls(*wire)


_COMMON_WELCOME_SIZE = 46
"""Up to `telemetry_Hz`."""


_FULL_OPENING = 0xFFFF


def _opening_to_wire(opening: float) -> int:
    if not 0.0 <= opening <= 1.0:
        raise MalformedMessageError(f"opening {opening} is not within 0…1")
    return int(opening * _FULL_OPENING + 0.5)


@dataclass(frozen=True, slots=True)
class Telemetry(_Body):
    """Device to host, `telemetry_Hz` times a second, from power-up on.

    `number` is that of the last accepted setpoint or vent, 0 before the first. `setpoint_kPa` is the
    regulator's present setpoint on its way to the target, 0 outside REGULATE. While `faults` has a sensor's
    fault, the pressure of this sensor is its last valid reading. Openings are 0…65535 on the wire. EVP:
    inflation valve. DVP: valve that supplies the Venturi.
    """

    TYPE: ClassVar[int] = 0x82
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<IBHHfffHHB")

    device_time_ms: int
    mode: Mode
    faults: Fault
    number: int
    setpoint_kPa: float
    cv_kPa: float
    reservoir_kPa: float
    evp_opening: float
    dvp_opening: float
    solenoid: bool

    def _to_wire(self) -> Sequence[Any]:
        return (
            self.device_time_ms,
            self.mode,
            self.faults,
            self.number,
            self.setpoint_kPa,
            self.cv_kPa,
            self.reservoir_kPa,
            _opening_to_wire(self.evp_opening),
            _opening_to_wire(self.dvp_opening),
            self.solenoid,
        )

    @classmethod
    def _from_wire(cls, values: tuple[Any, ...]) -> Self:
        time_ms, mode, faults, number, setpoint, cv, reservoir, evp, dvp, solenoid = values
        known_mode = _MODES.get(mode)
        if known_mode is None:
            raise MalformedMessageError(f"Telemetry's mode {mode} is not one of 0, 1, 2")
        if solenoid > 1:
            raise MalformedMessageError(f"Telemetry's solenoid is {solenoid}, not 0 or 1")
        return cls(
            device_time_ms=time_ms,
            mode=known_mode,
            faults=Fault(faults) if faults else Fault.NONE,
            number=number,
            setpoint_kPa=setpoint,
            cv_kPa=cv,
            reservoir_kPa=reservoir,
            evp_opening=evp / _FULL_OPENING,
            dvp_opening=dvp / _FULL_OPENING,
            solenoid=bool(solenoid),
        )


@dataclass(frozen=True, slots=True)
class Refusal(_Body):
    """Device to host: command `number` (0 for a message without number) was not carried out.

    The layouts of this message and of `Hello` are the same in every protocol version.
    """

    TYPE: ClassVar[int] = 0x83
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<HB")

    number: int
    reason: RefusalReason

    @classmethod
    def _from_wire(cls, values: tuple[Any, ...]) -> Self:
        number, reason = values
        try:
            return cls(number, RefusalReason(reason))
        except ValueError:
            raise MalformedMessageError(f"Refusal's reason {reason} is not known") from None


@dataclass(frozen=True, slots=True)
class Pong(_Body):
    """Device to host, in answer to `Ping`."""

    TYPE: ClassVar[int] = 0x84
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<QI")

    host_time_us: int
    device_time_ms: int


@dataclass(frozen=True, slots=True)
class Setting(_Body):
    """Device to host, in answer to `GetSetting` and `SetSetting`: one of `count` settings.

    `name` ends with the unit. The device refuses values outside `least` … `most`. `standard` is the default.
    """

    TYPE: ClassVar[int] = 0x85
    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<BB24sffff")

    id: int
    count: int
    name: str
    value: float
    least: float
    most: float
    standard: float

    def _to_wire(self) -> Sequence[Any]:
        values = [getattr(self, name) for name in self.__match_args__]
        values[2] = _text_to_wire(self.name, 24, "setting name")
        return values

    @classmethod
    def _from_wire(cls, values: tuple[Any, ...]) -> Self:
        wire: list[Any] = [*values[:2], _text_from_wire(values[2], "Setting's name"), *values[3:]]
        return cls(*wire)


HostMessage = Hello | Setpoint | Vent | ClearFaults | Ping | GetSetting | SetSetting
DeviceMessage = Welcome | Telemetry | Refusal | Pong | Setting
Message = HostMessage | DeviceMessage

_TYPES: dict[int, type[Message]] = {
    kind.TYPE: kind
    for kind in (
        *(Hello, Setpoint, Vent, ClearFaults, Ping, GetSetting, SetSetting),
        *(Welcome, Telemetry, Refusal, Pong, Setting),
    )
}
_HEADER_SIZE = 2


def encode(message: Message, sequence: int) -> bytes:
    """A complete frame. Raises MalformedMessageError if a value does not fit its field."""
    return encode_frame(bytes((message.TYPE, sequence & 0xFF)) + message.pack())


def decode(payload: bytes) -> tuple[Message, int]:
    """The message and sequence number in a frame's payload. Raises ProtocolError if it is not a message."""
    if len(payload) < _HEADER_SIZE:
        raise MalformedMessageError(f"a payload of {len(payload)} bytes has no room for type and sequence")
    kind = _TYPES.get(payload[0])
    if kind is None:
        raise UnknownMessageError(
            f"message type 0x{payload[0]:02X} is not known to version {PROTOCOL_VERSION}"
        )
    return kind.unpack(payload[_HEADER_SIZE:]), payload[1]


class Codec:
    """Converts between bytes and messages at one end of a link. `decode` never raises."""

    def __init__(self) -> None:
        self.lost_frames = 0
        """Frames missing between sequence numbers. A jump of 128 or more is a restart, not a loss."""
        self.unknown_messages = 0
        """Frames with a good CRC that are not a message of this version."""
        self._frames = FrameDecoder()
        self._sequence_out = 0
        self._sequence_in: int | None = None
        self._nonce: int | None = None
        """Of our last `Hello`. Only the answer to it has our session."""
        self._session = 0
        self._setpoints = 0
        """The setpoints that were sent in this session."""

    @property
    def good_frames(self) -> int:
        return self._frames.good_frames

    @property
    def bad_frames(self) -> int:
        """The number of frames with a wrong CRC and of byte sequences that are not frames."""
        return self._frames.bad_frames

    def restart(self) -> None:
        """The line was opened again: forget the incomplete frame and the sequence, keep the counts."""
        frames = FrameDecoder()
        frames.good_frames, frames.bad_frames = self._frames.good_frames, self._frames.bad_frames
        self._frames = frames
        self._sequence_in = None

    def encode(self, message: Message) -> bytes:
        """A complete frame with the next sequence number. Raises MalformedMessageError like `pack`.

        A setpoint gets the session of the latest `Welcome` to our `Hello`, and the next count.
        """
        if isinstance(message, Hello):
            self._nonce = message.nonce
        if isinstance(message, Setpoint):
            self._setpoints += 1
            message = replace(message, session=self._session, count=self._setpoints)
        frame = encode(message, self._sequence_out)
        self._sequence_out = (self._sequence_out + 1) & 0xFF
        return frame

    def decode(self, data: bytes) -> list[Message]:
        """The messages whose frames end within `data`, in order."""
        messages: list[Message] = []
        for payload in self._frames.feed(data):
            if len(payload) >= _HEADER_SIZE:
                self._note_sequence(payload[1])
            try:
                message = decode(payload)[0]
            except ProtocolError:
                self.unknown_messages += 1
                continue
            # Others on the line get a `Welcome`, too, and a line may repeat ours: the count must not restart.
            if (
                isinstance(message, Welcome)
                and message.nonce == self._nonce
                and message.session != self._session
            ):
                self._session, self._setpoints = message.session, 0
            messages.append(message)
        return messages

    def _note_sequence(self, sequence: int) -> None:
        if self._sequence_in is not None:
            missing = (sequence - self._sequence_in - 1) & 0xFF
            if missing < 0x80:
                self.lost_frames += missing
        self._sequence_in = sequence
