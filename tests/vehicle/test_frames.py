"""The start and end of frames: in noise, after lost bytes, and with a wrong length."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from random_frames import MAX_FRAME_SIZE

from examples import examples
from flying_vines.vehicle.mavlink.frames import Frame, Frames


def packed(count: int, version_1: bool = False) -> list[bytes]:
    mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    frames = []
    for i in range(count):
        message = mavlink.MAVLink_attitude_message(i, 0.1, -0.2, 3.0, 0.0, 0.01, -1.0)
        frames.append(message.pack(mav, force_mavlink1=version_1))
        mav.seq = (mav.seq + 1) % 256
    return frames


def unknown(frame: bytes) -> bytes:
    """The frame with the number of a message that the dialect lacks."""
    return frame[:7] + (50_000).to_bytes(3, "little") + frame[10:]


def raws(found: list[Frame]) -> list[bytes]:
    return [frame.raw for frame in found]


def test_a_frame_has_the_values_of_its_header() -> None:
    (frame,) = Frames().take(packed(1)[0])
    assert (frame.message_id, frame.system, frame.component, frame.sequence) == (30, 1, 1, 0)
    assert frame.known and not frame.signed
    assert frame.payload == frame.raw[10:-2]
    assert frame.checksum.to_bytes(2, "little") == frame.raw[-2:]


def test_version_1_has_a_shorter_header() -> None:
    (raw,) = packed(1, version_1=True)
    (frame,) = Frames().take(raw)
    assert (frame.message_id, frame.system, frame.component, frame.flags) == (30, 1, 1, 0)
    assert frame.payload == raw[6:-2]


@pytest.mark.parametrize("marker", [b"\xfd", b"\xfe"])
def test_a_stray_marker_costs_no_frame(marker: bytes) -> None:
    # The bytes behind it look like a header, mostly of a frame longer than the good one.
    good = packed(12)
    frames = Frames()
    assert raws(frames.take(good[0] + marker + b"".join(good[1:]))) == good
    assert frames.bad_frames == 1


def test_bytes_that_a_serial_line_loses_cost_few_other_frames() -> None:
    good = packed(4000)
    stream, of_frame = b"".join(good), [i for i, frame in enumerate(good) for _ in frame]
    dice = random.Random(1)
    gaps = [(dice.randrange(len(stream)), dice.randint(1, 12)) for _ in range(800)]
    lost = {min(at + i, len(stream) - 1) for at, size in gaps for i in range(size)}
    whole = len(good) - len({of_frame[at] for at in lost})
    received = bytes(byte for at, byte in enumerate(stream) if at not in lost)
    found = [frame.raw for frame in Frames().take(received) if frame.known]
    assert set(found) <= set(good)
    peer = mavlink.MAVLink(None)
    peer.robust_parsing = True
    theirs = sum(message.get_msgId() == 30 for message in peer.parse_buffer(received) or [])
    # After a frame with missing bytes most readers, also pymavlink, lose the next frame.
    assert theirs < whole - 400
    assert len(found) >= whole - 10


def test_a_frame_of_an_unknown_message_is_passed_over_as_a_whole() -> None:
    # Its payload may contain bytes like a frame, for example in a tunnel or a file.
    inner, before, after = packed(3)
    header = bytes((0xFD, len(inner), 0, 0, 7, 1, 1)) + (50_000).to_bytes(3, "little")
    outer = header + inner + b"\x12\x34"
    found = Frames().take(before + outer + after)
    assert raws(found) == [before, outer, after]
    assert [frame.known for frame in found] == [True, False, True]


def test_the_next_bytes_show_if_an_unknown_message_was_a_frame() -> None:
    good = packed(3)
    frames = Frames()
    assert raws(frames.take(good[0] + unknown(good[1]))) == [good[0]]
    assert raws(frames.take(good[2])) == [unknown(good[1]), good[2]]
    assert frames.bad_frames == 0
    assert raws(frames.take(unknown(good[1]) + b"noise" + good[2])) == [good[2]]
    assert frames.bad_frames == 1


def test_a_frame_with_unknown_incompatibility_flags_is_unknown() -> None:
    good = packed(2)
    strange = good[0][:2] + b"\x02" + good[0][3:]
    found = Frames().take(strange + good[1])
    assert [frame.known for frame in found] == [False, True]


@given(
    parts=st.lists(
        st.one_of(
            st.integers(0, 29), st.binary(max_size=30), st.binary(max_size=300).map(lambda b: b"\xfd" + b)
        ),
        max_size=15,
    ),
    cuts=st.lists(st.integers(0, 5000), max_size=30),
)
@settings(max_examples=examples(150), deadline=None)
def test_chunking_changes_nothing(parts: list[int | bytes], cuts: list[int]) -> None:
    good = packed(10) + packed(10, version_1=True) + [unknown(frame) for frame in packed(10)]
    stream = b"".join(good[part] if isinstance(part, int) else part for part in parts)
    whole, split = Frames(), Frames()
    at_once = whole.take(stream)
    ends = sorted({cut % (len(stream) + 1) for cut in cuts} | {len(stream)})
    found = [f for begin, end in zip([0, *ends], ends, strict=False) for f in split.take(stream[begin:end])]
    assert found == at_once
    assert split.bad_frames == whole.bad_frames
    assert len(split._rest) <= MAX_FRAME_SIZE


def test_noise_counts_once_however_it_arrives() -> None:
    frames = Frames()
    for byte in b"no frame in here":
        frames.take(bytes((byte,)))
    assert frames.bad_frames == 1
    frames.take(packed(1)[0])
    frames.take(b"nor here")
    assert frames.bad_frames == 2


def test_each_broken_frame_counts() -> None:
    broken = [frame[:-1] + bytes((frame[-1] ^ 1,)) for frame in packed(20)]
    frames = Frames()
    assert frames.take(b"".join(broken)) == []
    assert frames.bad_frames == 20


def test_behind_a_flood_of_false_headers_every_frame_is_found() -> None:
    # All state the maximum length, so the last ones reach far into the good frames.
    hostile = b"".join(bytes((0xFD, 0xFF, 0, 0, i % 0xFD, 1, 1, 30, 0, 0)) for i in range(3000))
    frames, good = Frames(), packed(20)
    assert frames.take(hostile) == []
    assert raws(frames.take(b"".join(good))) == good
