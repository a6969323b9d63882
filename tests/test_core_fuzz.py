"""Valid MAVLink messages of every type with nonsense in them, and hostile firmware messages."""

from __future__ import annotations

import random
import struct

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from firmware_link import protocol
from flying_vines import config
from flying_vines.core import Core
from flying_vines.events import (
    Event,
    FirmwareMessage,
    LinkChanged,
    Tick,
    ToFirmware,
    ToVehicle,
    VehicleMessage,
)
from flying_vines.vehicle.codec import Codec

MESSAGES = 40_000
SENDERS = [(1, 1), (1, 1), (1, 1), (255, 190), (1, 154), (2, 1), (1, 191), (0, 0)]
ODD_FLOATS = [float("nan"), float("inf"), float("-inf"), 3e38, -1.0, 0.0, 1.0]


def strange_frame(dice: random.Random, sequence: int) -> bytes:
    """A frame with a good checksum, a known type, and a payload of random or odd values."""
    kind = dice.choice(list(mavlink.mavlink_map.values()))
    payload = bytearray(dice.randbytes(kind.unpacker.size))
    if dice.random() < 0.5 and len(payload) >= 4:
        payload[:4] = struct.pack("<f", dice.choice(ODD_FLOATS))
    if kind.id in (75, 76) and dice.random() < 0.7:
        # Commands: often to us, so that what they hold matters.
        payload[-5:] = bytes((0, 0, dice.choice((0, 1)), dice.choice((0, 191)), 0))
        struct.pack_into("<H", payload, 28, dice.choice((31010, 31011, 31012, 31013, 31014, 211, 187)))
    system, component = dice.choice(SENDERS)
    header = struct.pack(
        "<BBBBBBBHB",
        0xFD,
        len(payload),
        0,
        0,
        sequence & 0xFF,
        system,
        component,
        kind.id & 0xFFFF,
        kind.id >> 16,
    )
    crc = mavlink.x25crc(header[1:] + bytes(payload))
    crc.accumulate(struct.pack("B", kind.crc_extra))
    return header + bytes(payload) + struct.pack("<H", crc.crc)


def test_no_message_raises_and_no_setpoint_leaves_its_limits() -> None:
    dice = random.Random(20)
    core, codec, out = Core(config.default()), Codec(0, 191), Codec(0, 191)
    core.handle(LinkChanged(0.0, "firmware", True))
    decoded = 0
    for i in range(MESSAGES):
        t = i * 0.004
        events: list[Event] = [VehicleMessage(t, message) for message in codec.decode(strange_frame(dice, i))]
        decoded += len(events)
        for event in [*events, Tick(t)]:
            for action in core.handle(event):
                if isinstance(action, ToVehicle):
                    assert out.encode(action.message, action.system_id)
                elif isinstance(action, ToFirmware):
                    assert not isinstance(action.message, protocol.Setpoint)
    assert decoded > 0.9 * MESSAGES
    assert core.snapshot(MESSAGES * 0.004).doing == "vented"


def test_telemetry_that_makes_no_sense_moves_nothing() -> None:
    dice = random.Random(3)
    core = Core(config.default())
    core.handle(LinkChanged(0.0, "firmware", True))

    def odd() -> float:
        return dice.choice([*ODD_FLOATS, dice.uniform(-1e3, 1e3)])

    for i in range(5_000):
        t = i * 0.01
        nonce = dice.choice((1, dice.getrandbits(32)))
        welcome = protocol.Welcome(1, nonce, dice.randrange(3), "x", 1, odd(), odd(), odd(), odd(), 300, 100)
        telemetry = protocol.Telemetry(
            dice.getrandbits(32), protocol.Mode.VENT, protocol.Fault(dice.getrandbits(16)), 0,
            odd(), odd(), odd(), 0.0, 0.0, False,
        )  # fmt: skip
        for message in (welcome, telemetry):
            for action in core.handle(FirmwareMessage(t, message)):
                assert not (isinstance(action, ToFirmware) and isinstance(action.message, protocol.Setpoint))
        core.handle(Tick(t))
    assert core.snapshot(50.0).doing == "vented"
