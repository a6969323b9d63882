"""Messages: the golden vectors in both directions, and invalid input."""

from __future__ import annotations

import itertools
import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_link.framing import FrameDecoder, crc16, encode_frame
from firmware_link.protocol import (
    PROTOCOL_VERSION,
    ClearFaults,
    Codec,
    Fault,
    GetSetting,
    Hello,
    MalformedMessageError,
    Message,
    Mode,
    Ping,
    Pong,
    ProtocolError,
    Refusal,
    RefusalReason,
    Setpoint,
    SetSetting,
    Setting,
    SettingsMemory,
    Telemetry,
    UnknownMessageError,
    Vent,
    Welcome,
    decode,
    encode,
)

GOLDEN: dict[str, Any] = json.loads(Path(__file__).with_name("golden_vectors.json").read_text())

u8, u16, u32 = (st.integers(0, (1 << bits) - 1) for bits in (8, 16, 32))
u64 = st.integers(0, (1 << 64) - 1)
f32 = st.floats(width=32, allow_nan=False)
openings = u16.map(lambda raw: raw / 0xFFFF)
builds = st.text(st.characters(min_codepoint=0x20, max_codepoint=0x7E), max_size=16)
names = st.text(st.characters(min_codepoint=0x20, max_codepoint=0x7E), max_size=24)

messages: st.SearchStrategy[Message] = st.one_of(
    st.builds(Hello, u8, u32),
    st.builds(Setpoint, f32, f32, u16, u16, u32, u32),
    st.builds(Vent, u16),
    st.builds(ClearFaults, u16),
    st.builds(Ping, u64),
    st.builds(
        Welcome,
        st.just(PROTOCOL_VERSION),
        u32,
        u32,
        builds,
        u8,
        *[f32] * 4,
        u16,
        u16,
        u32,
        u32,
        st.sampled_from(SettingsMemory),
    ),
    st.builds(
        Telemetry,
        u32,
        st.sampled_from(Mode),
        u16.map(Fault),
        u16,
        f32,
        f32,
        f32,
        openings,
        openings,
        st.booleans(),
    ),
    st.builds(Refusal, u16, st.sampled_from(RefusalReason)),
    st.builds(Pong, u64, u32),
    st.builds(GetSetting, u8),
    st.builds(SetSetting, u8, f32),
    st.builds(Setting, u8, u8, names, f32, f32, f32, f32),
)


KINDS = {kind.__name__: kind for kind in get_args(Message)}


def message_of(vector: dict[str, Any]) -> Message:
    fields = dict(vector["fields"])
    match vector["message"]:
        case "Telemetry":
            fields["mode"] = Mode(fields["mode"])
            fields["faults"] = Fault(fields["faults"])
        case "Welcome":
            fields["settings_memory"] = SettingsMemory(fields["settings_memory"])
        case "Refusal":
            fields["reason"] = RefusalReason(fields["reason"])
    message: Message = KINDS[vector["message"]](**fields)
    return message


@pytest.mark.parametrize("vector", GOLDEN["crc16"])
def test_golden_crc(vector: dict[str, Any]) -> None:
    assert crc16(bytes.fromhex(vector["data_hex"])) == vector["crc"]


@pytest.mark.parametrize("vector", GOLDEN["frames"])
def test_golden_frames_both_ways(vector: dict[str, Any]) -> None:
    message = message_of(vector)
    assert encode(message, vector["sequence"]).hex() == vector["frame_hex"]
    (payload,) = FrameDecoder().feed(bytes.fromhex(vector["frame_hex"]))
    assert decode(payload) == (message, vector["sequence"])


@pytest.mark.parametrize("vector", GOLDEN["refused_frames"], ids=lambda vector: vector["why"])
def test_golden_frames_that_are_refused(vector: dict[str, Any]) -> None:
    codec = Codec()
    assert codec.decode(bytes.fromhex(vector["frame_hex"])) == []
    assert codec.bad_frames + codec.unknown_messages == 1


def test_every_message_has_a_golden_frame() -> None:
    assert {vector["message"] for vector in GOLDEN["frames"]} == set(KINDS)


def test_a_frame_put_together_by_hand() -> None:
    """Vent number 0x0102, sequence 4: 03 04 02 01, then the CRC."""
    body = bytes.fromhex("03040201")
    frame = bytes([7]) + body + crc16(body).to_bytes(2, "big") + b"\x00"
    assert encode(Vent(0x0102), 4) == frame


@given(messages, u8)
def test_messages_round_trip(message: Message, sequence: int) -> None:
    (payload,) = FrameDecoder().feed(encode(message, sequence))
    assert decode(payload) == (message, sequence)


@given(st.binary(max_size=128))
def test_a_payload_is_a_message_or_a_protocol_error(payload: bytes) -> None:
    try:
        message, sequence = decode(payload)
    except ProtocolError as error:
        assert str(error)
    else:
        assert 0 <= sequence <= 255
        assert payload[0] == message.TYPE


@given(messages, st.data())
def test_a_wrong_length_is_malformed(message: Message, data: st.DataObject) -> None:
    payload = bytes([message.TYPE, 0]) + message.pack()
    wrong = data.draw(st.one_of(st.integers(2, len(payload) - 1).map(lambda n: payload[:n])))
    with pytest.raises(MalformedMessageError):
        decode(wrong)


def test_an_unknown_type_is_reported() -> None:
    with pytest.raises(UnknownMessageError, match="0x7F"):
        decode(b"\x7f\x00")


def test_the_start_of_another_versions_welcome_can_be_read() -> None:
    welcome = Welcome(PROTOCOL_VERSION + 1, 5, 6, "later", 1, 30.0, 28.0, 760.0, 200.0, 300, 100)
    payload = bytes([Welcome.TYPE, 0]) + welcome.pack()
    assert decode(payload + b"more in a later version")[0] == welcome
    ours = Welcome(PROTOCOL_VERSION, 5, 6, "ours", 1, 30.0, 28.0, 760.0, 200.0, 300, 100)
    with pytest.raises(MalformedMessageError):
        decode(bytes([Welcome.TYPE, 0]) + ours.pack() + b"more")


@pytest.mark.parametrize(
    "message",
    [
        Vent(-1),
        Vent(0x10000),
        Setpoint(1e300, 1.0, 1, 1),
        Welcome(1, 0, 0, "seventeen letters", 1, 1.0, 1.0, 1.0, 1.0, 1, 1),
        Welcome(1, 0, 0, "Ümlaut", 1, 1.0, 1.0, 1.0, 1.0, 1, 1),
        Welcome(1, 0, 0, "a\x00b", 1, 1.0, 1.0, 1.0, 1.0, 1, 1),
        Telemetry(0, Mode.VENT, Fault.NONE, 0, 0.0, 0.0, 0.0, 1.01, 0.0, False),
        Telemetry(0, Mode.VENT, Fault.NONE, 0, 0.0, 0.0, 0.0, float("nan"), 0.0, False),
    ],
)
def test_values_that_do_not_fit_are_not_sent(message: Message) -> None:
    with pytest.raises(MalformedMessageError):
        encode(message, 0)


def _telemetry_payload(**wrong: int) -> bytes:
    good = Telemetry(0, Mode.VENT, Fault.NONE, 0, 0.0, 0.0, 0.0, 0.0, 0.0, True)
    payload = bytearray(bytes([Telemetry.TYPE, 0]) + good.pack())
    for name, value in wrong.items():
        payload[{"mode": 6, "solenoid": -1}[name]] = value
    return bytes(payload)


def test_values_outside_an_enumeration_are_malformed() -> None:
    decode(_telemetry_payload())
    for wrong in (_telemetry_payload(mode=3), _telemetry_payload(solenoid=2)):
        with pytest.raises(MalformedMessageError):
            decode(wrong)
    for reason in (0, 8):
        with pytest.raises(MalformedMessageError):
            decode(bytes([Refusal.TYPE, 0, 0, 0, reason]))


@given(st.binary(max_size=1000))
def test_the_codec_never_raises(data: bytes) -> None:
    Codec().decode(data)


@given(st.lists(messages, max_size=10))
def test_the_codec_pairs_up(sent: list[Message]) -> None:
    sender, receiver = Codec(), Codec()
    # The codec fills in session and count of a setpoint.
    setpoints = itertools.count(1)
    wanted = [
        replace(message, session=0, count=next(setpoints)) if isinstance(message, Setpoint) else message
        for message in sent
    ]
    assert receiver.decode(b"".join(map(sender.encode, sent))) == wanted
    assert (receiver.lost_frames, receiver.bad_frames, receiver.unknown_messages) == (0, 0, 0)
    assert receiver.good_frames == len(sent)


def welcome(nonce: int, session: int) -> Welcome:
    return Welcome(PROTOCOL_VERSION, nonce, 6, "x", 1, 30.0, 28.0, 760.0, 200.0, 300, 100, session)


def test_the_codec_counts_the_setpoints_of_each_session() -> None:
    codec, board = Codec(), Codec()

    def sent() -> tuple[int, int]:
        (setpoint,) = board.decode(codec.encode(Setpoint(1.0, 1.0, 250, 9)))
        assert isinstance(setpoint, Setpoint)
        return setpoint.session, setpoint.count

    assert [sent(), sent()] == [(0, 1), (0, 2)]
    codec.encode(Hello(PROTOCOL_VERSION, 5))
    for session in (77, 4_000_000_000):
        codec.decode(board.encode(welcome(5, session)))
        codec.restart()
        assert [sent() for _ in range(300)] == [(session, count) for count in range(1, 301)]


def test_no_other_welcome_changes_the_session_of_a_codec() -> None:
    """A line repeats our `Welcome`, or another host gets one."""
    host, board = Codec(), Codec()
    host.encode(Hello(PROTOCOL_VERSION, 5))
    host.decode(board.encode(welcome(5, 77)))
    counts = []
    for other in (welcome(5, 77), welcome(5, 77), welcome(6, 78)):
        (told,) = board.decode(host.encode(Setpoint(1.0, 2.0, 250, 1)))
        assert isinstance(told, Setpoint)
        assert told.session == 77
        counts.append(told.count)
        assert host.decode(board.encode(other)) == [other]
    (told,) = board.decode(host.encode(Setpoint(1.0, 2.0, 250, 1)))
    assert isinstance(told, Setpoint)
    assert (told.session, [*counts, told.count]) == (77, [1, 2, 3, 4])


def test_the_codec_counts_what_it_missed_across_the_wrap() -> None:
    sender, receiver = Codec(), Codec()
    frames = [sender.encode(Vent(number)) for number in range(300)]
    kept = [frame for at, frame in enumerate(frames) if at not in (10, 255, 256, 257)]
    assert len(receiver.decode(b"".join(kept))) == 296
    assert receiver.lost_frames == 4


def test_a_sender_that_starts_anew_is_not_a_loss() -> None:
    receiver = Codec()
    receiver.decode(encode(Vent(1), 20) + encode(Vent(2), 0))
    assert receiver.lost_frames == 0


def test_unknown_messages_are_counted_and_passed_over() -> None:
    codec = Codec()
    data = encode(Vent(1), 0) + encode_frame(b"\x7f\x01") + encode_frame(b"\x03") + encode(Vent(2), 2)
    assert codec.decode(data) == [Vent(1), Vent(2)]
    assert codec.unknown_messages == 2
    assert codec.lost_frames == 0


def test_restart_forgets_the_line_and_keeps_the_counts() -> None:
    codec = Codec()
    codec.decode(b"\x05abc\x00" + encode(Vent(1), 0) + encode(Vent(2), 1)[:4])
    codec.restart()
    assert codec.decode(encode(Vent(3), 77)) == [Vent(3)]
    assert (codec.bad_frames, codec.good_frames, codec.lost_frames) == (1, 2, 0)


def test_the_messages_are_small_values() -> None:
    assert asdict(Vent(3)) == {"number": 3}
    assert Vent(3) == Vent(3)
