"""Bytes to messages: any chunking, noise, copies, losses, both protocol versions."""

from __future__ import annotations

import random
import tracemalloc

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from random_frames import MAX_FRAME_SIZE

from examples import examples
from flying_vines.vehicle.mavlink.codec import (
    MAX_SENDERS,
    REMEMBERED_FRAMES,
    REMEMBERED_SENT,
    MavlinkCodec,
    MavlinkMessage,
)


class Sender:
    """One component that sends frames of either protocol version."""

    def __init__(self, system_id: int = 1, component_id: int = 1) -> None:
        self.mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)

    def frame(self, message: MavlinkMessage, version_1: bool = False) -> bytes:
        data: bytes = message.pack(self.mav, force_mavlink1=version_1)
        self.mav.seq = (self.mav.seq + 1) % 256
        return data

    def skip(self, frames: int) -> None:
        self.mav.seq = (self.mav.seq + frames) % 256


def text(words: str) -> MavlinkMessage:
    return mavlink.MAVLink_statustext_message(6, words.encode(), 0, 0)


def clock(time_boot_ms: int) -> MavlinkMessage:
    return mavlink.MAVLink_system_time_message(0, time_boot_ms)


def texts_of(messages: list[MavlinkMessage]) -> list[str]:
    return [message.text for message in messages if message.get_type() == "STATUSTEXT"]


def chunked(data: bytes, cuts: list[int]) -> list[bytes]:
    ends = sorted({cut % (len(data) + 1) for cut in cuts} | {len(data)})
    return [data[begin:end] for begin, end in zip([0, *ends[:-1]], ends, strict=True)]


@given(
    parts=st.lists(
        st.one_of(st.text("abc XYZ09", max_size=50), st.integers(0, 2**32 - 1), st.binary(max_size=40)),
        max_size=12,
    ),
    cuts=st.lists(st.integers(0, 4000), max_size=40),
)
@settings(max_examples=examples(150), deadline=None)
def test_any_chunking_gives_the_same_messages(parts: list[str | int | bytes], cuts: list[int]) -> None:
    sender = Sender()
    stream = b""
    for part in parts:
        match part:
            case str():
                stream += sender.frame(text(part))
            case int():
                stream += sender.frame(clock(part))
            case bytes():
                stream += part
    whole, split = MavlinkCodec(1, 191), MavlinkCodec(1, 191)
    at_once = [str(message) for message in whole.decode(stream)]
    assert [str(m) for chunk in chunked(stream, cuts) for m in split.decode(chunk)] == at_once
    assert (split.lost_frames, split.repeated_frames) == (whole.lost_frames, whole.repeated_frames)


def test_one_byte_at_a_time() -> None:
    sender, codec = Sender(), MavlinkCodec(1, 191)
    stream = b"".join(sender.frame(text(f"line {i}")) for i in range(5))
    found = [message for byte in stream for message in codec.decode(bytes((byte,)))]
    assert texts_of(found) == [f"line {i}" for i in range(5)]
    assert codec.bad_frames == codec.lost_frames == 0


@given(st.lists(st.binary(max_size=700), max_size=8))
@settings(max_examples=examples(150), deadline=None)
def test_random_bytes_never_raise_and_good_frames_are_read_after_them(garbage: list[bytes]) -> None:
    codec, sender = MavlinkCodec(1, 191), Sender()
    for chunk in garbage:
        codec.decode(chunk)
    # Garbage may look like the start of the longest frame, which then includes the following bytes.
    for _ in range(-(-2 * MAX_FRAME_SIZE // len(sender.frame(clock(1))))):
        codec.decode(sender.frame(clock(2)))
    assert texts_of(codec.decode(sender.frame(text("still here")))) == ["still here"]


@given(
    words=st.text("abcdefgh", min_size=1, max_size=50),
    changes=st.lists(st.tuples(st.integers(0, 80), st.integers(0, 255)), min_size=1, max_size=4),
    cut=st.integers(0, 80),
)
@settings(max_examples=examples(300), deadline=None)
def test_changed_and_cut_frames_never_raise(words: str, changes: list[tuple[int, int]], cut: int) -> None:
    codec, sender = MavlinkCodec(1, 191), Sender()
    frame = bytearray(sender.frame(text(words)))
    for at, value in changes:
        frame[at % len(frame)] = value
    codec.decode(bytes(frame))
    codec.decode(bytes(frame[: cut % len(frame)]))
    for i in range(60):
        codec.decode(sender.frame(clock(i)))
    assert texts_of(codec.decode(sender.frame(text("after")))) == ["after"]


def test_a_frame_with_any_one_bit_flipped_is_not_taken_for_another() -> None:
    frame = Sender().frame(text("Radio Failsafe"))
    for bit in range(8 * len(frame)):
        flipped = bytearray(frame)
        flipped[bit // 8] ^= 1 << bit % 8
        assert texts_of(MavlinkCodec(1, 191).decode(bytes(flipped))) == []


def test_reads_that_always_end_within_a_frame_do_not_fill_the_memory() -> None:
    codec, sender = MavlinkCodec(1, 191), Sender()
    frames = [sender.frame(text("a rather long text, to make a rather long frame")) for _ in range(64)]
    rotated = b"".join(frames)[7:] + b"".join(frames)[:7]
    codec.decode(b"".join(frames)[:7])
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        read = sum(len(codec.decode(rotated)) for _ in range(60))
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 64 * MAX_FRAME_SIZE
    assert read == 60 * len(frames)


def test_a_copy_is_dropped_even_after_another_frame() -> None:
    codec, sender = MavlinkCodec(1, 191), Sender()
    first, second = sender.frame(text("Mission: 3 Scripting")), sender.frame(text("Mission: 4 WP"))
    found = texts_of(codec.decode(first + second + first + second + second))
    assert found == ["Mission: 3 Scripting", "Mission: 4 WP"]
    assert codec.repeated_frames == 3
    assert codec.lost_frames == 0


def test_the_same_text_sent_again_is_no_copy() -> None:
    codec, sender = MavlinkCodec(1, 191), Sender()
    found = [texts_of(codec.decode(sender.frame(text("Mission: 3 Scripting")))) for _ in range(300)]
    assert all(found)
    assert codec.repeated_frames == 0


VENT = mavlink.MAVLink_command_long_message(1, 191, 31013, 0, 0, 0, 0, 0, 0, 0, 0)


def test_a_script_that_runs_again_is_heard_again() -> None:
    # Each run of a script counts from 0, so that all of its frames equal those of the last run.
    codec = MavlinkCodec(1, 191)
    for run in range(3):
        script = Sender(255, 0)
        request = script.frame(mavlink.MAVLink_param_request_list_message(1, 191))
        assert len(codec.decode(request + script.frame(VENT), 2.0 * run)) == 2


def test_a_copied_command_is_decoded_again_because_each_vent_must_act_and_be_answered() -> None:
    codec, frame = MavlinkCodec(1, 191), Sender(255, 0).frame(VENT)
    assert len(codec.decode(frame + frame, 1.0)) == 2


def test_equal_frames_of_two_senders_are_no_copies() -> None:
    codec = MavlinkCodec(1, 191)
    stream = Sender(1, 1).frame(text("hello")) + Sender(2, 1).frame(text("hello"))
    assert texts_of(codec.decode(stream)) == ["hello", "hello"]


@pytest.mark.parametrize("unseen", [0, 15, 20, 31, 63])
def test_frames_of_a_partly_forwarded_sender_are_no_copies(unseen: int) -> None:
    # A ground station's heartbeats are all equal, and its other frames do not reach us.
    codec, station = MavlinkCodec(1, 191), Sender(255, 190)
    heartbeat = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    for _ in range(600):
        assert codec.decode(station.frame(heartbeat))
        station.skip(unseen)
    assert codec.repeated_frames == 0


def test_losses_are_counted_over_the_wrap_of_the_sequence() -> None:
    codec, sender = MavlinkCodec(1, 191), Sender()
    for i in range(600):
        codec.decode(sender.frame(clock(i)))
    assert codec.lost_frames == 0
    sender.skip(7)
    codec.decode(sender.frame(clock(1)))
    assert codec.lost_frames == 7
    while sender.mav.seq != 254:
        codec.decode(sender.frame(clock(2)))
    sender.skip(3)
    codec.decode(sender.frame(clock(3)))
    assert codec.lost_frames == 10


def test_reordered_frames_are_all_read_and_none_counts_as_lost() -> None:
    codec, sender = MavlinkCodec(1, 191), Sender()
    frames = [sender.frame(text(str(i))) for i in range(500)]
    dice = random.Random(7)
    found: list[str] = []
    for begin in range(0, len(frames), 5):
        group = frames[begin : begin + 5]
        dice.shuffle(group)
        found += texts_of(codec.decode(b"".join(group)))
    assert sorted(found, key=int) == [str(i) for i in range(500)]
    assert codec.lost_frames <= 4  # the first may have been a late one
    assert codec.repeated_frames == 0


def test_messages_that_the_dialect_lacks_are_neither_returned_nor_counted_as_lost() -> None:
    codec, sender = MavlinkCodec(1, 191), Sender()
    for i in range(50):
        assert len(codec.decode(sender.frame(clock(i)))) == 1
        unknown = bytearray(sender.frame(clock(i)))
        unknown[7:10] = (50_000).to_bytes(3, "little")
        assert codec.decode(bytes(unknown)) == []
    assert codec.lost_frames == codec.bad_frames == 0


def test_mavlink_1_frames_are_read_among_mavlink_2() -> None:
    codec, sender = MavlinkCodec(1, 191), Sender()
    stream = sender.frame(text("one"), version_1=True) + sender.frame(text("two"))
    stream += sender.frame(text("three"), version_1=True)
    assert texts_of(codec.decode(stream)) == ["one", "two", "three"]
    assert codec.lost_frames == 0


def test_signed_frames_are_read_without_a_key() -> None:
    codec, sender = MavlinkCodec(1, 191), Sender()
    sender.mav.signing.secret_key = b"k" * 32
    sender.mav.signing.sign_outgoing = True
    frames = [sender.frame(text(f"signed {i}")) for i in range(3)]
    assert frames[0][2] & 1
    assert texts_of(codec.decode(b"".join(frames) + frames[1])) == ["signed 0", "signed 1", "signed 2"]


def test_our_frames_have_our_ids_and_counting_sequence_numbers() -> None:
    ours, peer = MavlinkCodec(0, 191), mavlink.MAVLink(None)
    peer.robust_parsing = True
    received = [peer.parse_char(ours.encode(text("hi"), 42)) for _ in range(258)]
    assert {(m.get_srcSystem(), m.get_srcComponent()) for m in received} == {(42, 191)}
    assert [m.get_seq() for m in received] == [i % 256 for i in range(258)]
    assert ours.encode(text("hi"), 42)[0] == 0xFD


def test_echoes_of_our_own_frames_are_dropped() -> None:
    ours, router = MavlinkCodec(1, 191), Sender()
    sent = [ours.encode(text(f"Vine: {i}"), 1) for i in range(REMEMBERED_SENT)]
    stream = b"".join(2 * frame + router.frame(clock(i)) for i, frame in enumerate(sent))
    assert texts_of(ours.decode(stream)) == []
    assert ours.echoes == 2 * REMEMBERED_SENT
    assert ours.lost_frames == 0


def test_frames_of_another_sender_with_our_ids_are_read() -> None:
    ours, twin = MavlinkCodec(1, 191), Sender(1, 191)
    ours.encode(text("Vine: ours"), 1)
    assert texts_of(ours.decode(twin.frame(text("Vine: theirs")))) == ["Vine: theirs"]
    assert ours.echoes == 0


def test_an_old_frame_of_ours_is_no_echo_any_more() -> None:
    ours = MavlinkCodec(1, 191)
    first = ours.encode(text("first"), 1)
    for i in range(REMEMBERED_SENT):
        ours.encode(clock(i), 1)
    assert texts_of(ours.decode(first)) == ["first"]


def test_a_signing_key_that_is_sent_to_us_is_masked() -> None:
    codec, station = MavlinkCodec(1, 191), Sender(255, 190)
    key = list(range(1, 33))
    (received,) = codec.decode(station.frame(mavlink.MAVLink_setup_signing_message(1, 191, key, 7)))
    assert (received.target_system, received.target_component, received.get_srcSystem()) == (1, 191, 255)
    assert (received.secret_key, received.initial_timestamp) == ([0] * 32, 0)
    assert bytes(key[:4]) not in received.get_msgbuf()
    (again,) = MavlinkCodec(1, 191).decode(bytes(received.get_msgbuf()))
    assert str(again) == str(received), "a log gets the masked message"
    assert texts_of(codec.decode(station.frame(text("next")))) == ["next"]
    assert codec.lost_frames == 0


def test_many_unknown_senders_neither_fill_the_memory_nor_displace_the_autopilot() -> None:
    codec, autopilot = MavlinkCodec(1, 191), Sender()
    for i in range(2 * REMEMBERED_FRAMES):
        codec.decode(autopilot.frame(clock(i)))
    frame = autopilot.frame(text("Mission: 3 Scripting"))
    assert codec.decode(frame)
    for system in range(2, 250):
        for component in range(4):
            assert codec.decode(Sender(system, component).frame(clock(1)))
    assert codec.decode(frame) == []
    assert codec.repeated_frames == 1
    assert len(codec._senders) <= MAX_SENDERS
