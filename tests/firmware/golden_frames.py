"""Conversations with every golden vector: each host frame, and an input that causes each device frame."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from firmware_link.framing import FrameDecoder
from firmware_link.protocol import (
    PROTOCOL_VERSION,
    ClearFaults,
    GetSetting,
    Hello,
    HostMessage,
    Message,
    Ping,
    Pong,
    Refusal,
    RefusalReason,
    Setpoint,
    SetSetting,
    Setting,
    SettingsMemory,
    Telemetry,
    Units,
    Welcome,
    decode,
    encode,
)
from flying_vines.simulation.phlosar.firmware import setting_rows

from .golden_run import BoardInput, Done, PowerUp, Step

VECTORS: dict[str, Any] = json.loads(
    (Path(__file__).parents[1] / "firmware_link" / "golden_vectors.json").read_text()
)
IDS = {name: row.number for name, row in setting_rows().items()}
HELLO = Hello(PROTOCOL_VERSION, 1)
_READINGS = (5958, 27_880, 59_578)
_BUILD = "golden"
_BOOT_ID = 5
_STANDARD = {name: row.standard for name, row in setting_rows().items()}


class Conversation(NamedTuple):
    inputs: list[BoardInput]
    answers: list[Message]
    """Answers to the last frame, without telemetry."""


def of_host_frame(frame: bytes) -> Conversation:
    """A board that has just booted receives `frame`."""
    told = [*_booted(), _said(1, frame)]
    match _message(frame):
        case Hello(version, nonce):
            answers: list[Message] = [_welcome(nonce)]
            if version != PROTOCOL_VERSION:
                answers.append(Refusal(0, RefusalReason.VERSION))
        case Setpoint(number=number):
            answers = [Refusal(number, RefusalReason.NO_HANDSHAKE)]
        case ClearFaults() | SetSetting():
            answers = [Refusal(0, RefusalReason.NO_HANDSHAKE)]
        case Ping(host_time_us):
            answers = [Pong(host_time_us, 0)]
        case GetSetting(number):
            answers = [_setting(number, list(_STANDARD.values())[number])]
        case _:
            answers = []
    return Conversation(told, answers)


def to_device_frame(frame: bytes) -> Conversation | None:
    """Inputs that make a board send `frame`, except for its sequence number; None if no board of ours sends
    it."""
    message = _message(frame)
    answers = [message]
    match message:
        case Welcome():
            told = _to_welcome(message)
        case Pong(host_time_us, device_time_ms):
            told = [*_booted(), _said(device_time_ms), _said(device_time_ms, Ping(host_time_us))]
        case Refusal(_, RefusalReason.VERSION):
            told = [*_booted(), _said(1, Hello(PROTOCOL_VERSION + 1, 1))]
            answers = [_welcome(1), message]
        case Refusal():
            told = _to_refusal(message)
        case Setting(number, value=value):
            if frames([message]) != frames([_setting(number, value)]):
                return None
            told = [*_booted(), _said(1, HELLO), _said(2, SetSetting(number, value))]
        case _:
            return None
    return Conversation(told, answers)


def answers_in(done: Done) -> list[Message]:
    messages = [decode(payload)[0] for payload in FrameDecoder().feed(done.sent)]
    return [message for message in messages if not isinstance(message, Telemetry)]


def frames(messages: list[Message]) -> list[bytes]:
    """The frames without their sequence numbers."""
    return [encode(message, 0) for message in messages]


def _to_welcome(welcome: Welcome) -> list[BoardInput]:
    values = {
        "cv_limit_kPa": welcome.cv_limit_kPa,
        "setpoint_margin_kPa": welcome.cv_limit_kPa - welcome.setpoint_limit_kPa,
        "reservoir_limit_kPa": welcome.reservoir_limit_kPa,
        "rate_limit_kPa_per_s": welcome.rate_limit_kPa_per_s,
        "dead_man_ms": welcome.dead_man_ms,
        "telemetry_Hz": welcome.telemetry_Hz,
    }
    settings = [SetSetting(IDS[name], value) for name, value in values.items()]
    return [
        *_booted(welcome.boot_id, welcome.firmware_build),
        _said(1, HELLO, *settings),
        _said(2, Hello(PROTOCOL_VERSION, welcome.nonce)),
    ]


def _to_refusal(refusal: Refusal) -> list[BoardInput]:
    number = refusal.number
    match refusal.reason:
        case RefusalReason.NO_HANDSHAKE:
            return [*_booted(), _said(1, Setpoint(1.0, 1.0, 1, number))]
        case RefusalReason.OUT_OF_RANGE:
            return [*_booted(), _said(1, HELLO), _said(2, _setpoint(1.0, 0, number))]
        case RefusalReason.NOT_A_NUMBER:
            return [*_booted(), _said(1, HELLO), _said(2, _setpoint(math.nan, 1, number))]
        case RefusalReason.FAULT_LATCHED:
            booted = _booted(by_watchdog=True)
            return [*booted, _said(1, HELLO), _said(2, _setpoint(1.0, 1, number))]
        case _:
            begun = [_said(1, HELLO), _said(2, _setpoint(1.0, 100, 1))]
            return [*_booted(), *begun, _said(3, SetSetting(0, 20.0))]


def _setpoint(target_kPa: float, ttl_ms: int, number: int) -> Setpoint:
    """The first one after the first handshake."""
    return Setpoint(target_kPa, 1.0, ttl_ms, number, session_of(_BOOT_ID, 1), 1)


def session_of(boot_id: int, greetings: int) -> int:
    return (boot_id * 0x9E3779B1 + greetings) & 0xFFFFFFFF


def digest_of(values: Iterable[float]) -> int:
    """FNV-1a of the settings' values."""
    digest = 0x811C9DC5
    for byte in b"".join(struct.pack("<f", value) for value in values):
        digest = (digest ^ byte) * 0x01000193 & 0xFFFFFFFF
    return digest


def _booted(boot_id: int = _BOOT_ID, build: str = _BUILD, *, by_watchdog: bool = False) -> list[BoardInput]:
    return [PowerUp(boot_id, by_watchdog, build, b""), _said(0)]


def _said(ms: int, *said: HostMessage | bytes) -> Step:
    frames = [frame if isinstance(frame, bytes) else encode(frame, 0) for frame in said]
    return Step(1000 * ms, *_READINGS, 1024, b"".join(frames))


def _message(frame: bytes) -> Message:
    (payload,) = FrameDecoder().feed(frame)
    return decode(payload)[0]


def _welcome(nonce: int) -> Welcome:
    return Welcome(
        protocol_version=PROTOCOL_VERSION,
        nonce=nonce,
        boot_id=_BOOT_ID,
        firmware_build=_BUILD,
        units=Units.KPA_GAUGE,
        cv_limit_kPa=_STANDARD["cv_limit_kPa"],
        setpoint_limit_kPa=_STANDARD["cv_limit_kPa"] - _STANDARD["setpoint_margin_kPa"],
        reservoir_limit_kPa=_STANDARD["reservoir_limit_kPa"],
        rate_limit_kPa_per_s=_STANDARD["rate_limit_kPa_per_s"],
        dead_man_ms=int(_STANDARD["dead_man_ms"]),
        telemetry_Hz=int(_STANDARD["telemetry_Hz"]),
        session=session_of(_BOOT_ID, 1),
        settings_digest=digest_of(_STANDARD.values()),
        settings_memory=SettingsMemory.ERASED,
    )


def _setting(number: int, value: float) -> Setting:
    name, row = list(setting_rows().items())[number]
    return Setting(number, len(IDS), name, value, row.min, row.max, row.standard)
