"""Payloads are decoded like by pymavlink, for every type of the dialect."""

from __future__ import annotations

import random

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.mavlink.frames import Frames
from flying_vines.vehicle.mavlink.payloads import HeaderOnly, MavlinkMessage, message_of

TYPES = sorted(mavlink.mavlink_map)


def frame_of(
    message_id: int, payload: bytes, version_1: bool = False, sender: tuple[int, int] = (1, 1)
) -> bytes:
    """A frame with a good checksum around any payload."""
    if version_1:
        head = bytes((0xFE, len(payload), 17, *sender, message_id))
    else:
        head = bytes((0xFD, len(payload), 0, 0, 17, *sender)) + message_id.to_bytes(3, "little")
    extra = bytes((mavlink.mavlink_map[message_id].crc_extra,))
    crc: int = mavlink.x25crc(head[1:] + payload + extra).crc
    return head + payload + crc.to_bytes(2, "little")


def ours(frame: bytes) -> MavlinkMessage:
    (found,) = Frames().take(frame)
    return message_of(found)


def assert_same(message: MavlinkMessage, expected: MavlinkMessage) -> None:
    assert type(message) is type(expected)
    # As text, because NaN is not equal to itself.
    assert str(message.to_dict()) == str(expected.to_dict())
    assert message.get_header().__dict__ == expected.get_header().__dict__
    assert bytes(message.get_msgbuf()) == bytes(expected.get_msgbuf())
    assert message.get_crc() == expected.get_crc()
    assert message.get_fieldnames() == expected.get_fieldnames()


@pytest.mark.parametrize("message_id", TYPES)
def test_any_payload_of_any_length(message_id: int) -> None:
    dice = random.Random(message_id)
    size = mavlink.mavlink_map[message_id].unpacker.size
    for length in {1, size // 2 or 1, size, min(255, size + 3)}:
        for payload in (dice.randbytes(length), bytes(length), b"\xff" * length, b"abc\0def" * 40):
            raw = frame_of(message_id, payload[:length])
            assert_same(ours(raw), mavlink.MAVLink(None).decode(bytearray(raw)))


@pytest.mark.parametrize("message_id", [number for number in TYPES if number < 256])
def test_version_1(message_id: int) -> None:
    payload = random.Random(message_id).randbytes(mavlink.mavlink_map[message_id].unpacker.size)
    raw = frame_of(message_id, payload, version_1=True)
    assert_same(ours(raw), mavlink.MAVLink(None).decode(bytearray(raw)))


def test_the_payload_itself() -> None:
    raw = frame_of(0, bytes(range(1, 10)))
    assert ours(raw).get_payload() == bytes(range(1, 10))


def test_a_header_alone_gives_the_same_as_the_whole_message() -> None:
    methods = [name for name in vars(HeaderOnly) if name.startswith("get_")]
    assert len(methods) == 6
    for message_id in TYPES:
        (frame,) = Frames().take(frame_of(message_id, b"\x01", sender=(7, 190)))
        header, whole = HeaderOnly(frame), message_of(frame)
        for name in methods:
            assert getattr(header, name)() == getattr(whole, name)(), name


def test_a_decoded_message_packs_to_the_same_frame() -> None:
    mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    mav.seq = 17
    message = mavlink.MAVLink_statustext_message(4, b"Mission: 3 Scripting", 0, 0)
    raw = message.pack(mav)
    assert ours(raw).pack(mav) == raw
