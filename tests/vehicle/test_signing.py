"""Signing: accepted frames, and timestamps that never fall or repeat."""

from __future__ import annotations

import hashlib
import random
from pathlib import Path
from typing import Literal

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from examples import examples
from flying_vines.config import config
from flying_vines.core.snapshot import Snapshot
from flying_vines.simulation.autopilot.autopilot import FakeAutopilot
from flying_vines.simulation.simulated_world import SimulatedFlight
from flying_vines.vehicle.mavlink.codec import MavlinkCodec, MavlinkMessage
from flying_vines.vehicle.mavlink.signing import (
    MAX_STREAMS,
    UNITS_PER_S,
    UNIX_TIME_OF_ZERO_S,
    RefusedFrames,
    Signing,
    SigningMemory,
)
from flying_vines.vehicle.mavlink.tlog import TlogReader

KEY = hashlib.sha256(b"a passphrase for tests").digest()
NOW_S = 1_790_000_000.0
NOW = int((NOW_S - UNIX_TIME_OF_ZERO_S) * UNITS_PER_S)
MINUTE = 60 * UNITS_PER_S
RECORDINGS = Path(__file__).parents[1] / "data" / "recordings"


def crc_by_hand(data: bytes) -> int:
    """CRC-16/MCRF4XX, bit by bit."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x8408 if crc & 1 else 0)
    return crc


def signed_by_hand(
    payload: bytes,
    timestamp: int,
    key: bytes = KEY,
    link_id: int = 3,
    system: int = 1,
    component: int = 1,
    sequence: int = 0,
) -> bytes:
    """A signed STATUSTEXT as in MAVLink's documentation; it needs only a hash."""
    statustext, crc_extra = 253, 83
    header = bytes((len(payload), 1, 0, sequence, system, component)) + statustext.to_bytes(3, "little")
    crc = crc_by_hand(header + payload + bytes((crc_extra,)))
    frame = b"\xfd" + header + payload + crc.to_bytes(2, "little")
    frame += bytes((link_id,)) + timestamp.to_bytes(6, "little")
    return frame + hashlib.sha256(key + frame).digest()[:6]


class Peer:
    """One component with a key, implemented by hand."""

    def __init__(self, timestamp: int = NOW, system: int = 1, component: int = 1, link_id: int = 3) -> None:
        self.timestamp = timestamp
        self._system, self._component, self._link_id = system, component, link_id
        self._sequence = 0

    def say(self, words: str, key: bytes = KEY) -> bytes:
        payload = bytes((6,)) + words.encode()
        self.timestamp += 1
        self._sequence = (self._sequence + 1) % 256
        return signed_by_hand(
            payload, self.timestamp, key, self._link_id, self._system, self._component, self._sequence
        )


class Ours:
    """Our codec with a key, at `NOW_S`."""

    def __init__(self, timestamp: int = 0, clock_s: float | None = NOW_S, link_id: int = 0) -> None:
        self.signing = Signing(KEY, link_id, SigningMemory(timestamp))
        if clock_s is not None:
            self.signing.advance(clock_s)
        self.codec = MavlinkCodec(1, 191, self.signing)

    def receive(self, data: bytes) -> list[str]:
        return [message.text for message in self.codec.decode(data)]

    @property
    def refused(self) -> RefusedFrames:
        return self.signing.refused


def text(words: str) -> MavlinkMessage:
    return mavlink.MAVLink_statustext_message(6, words.encode(), 0, 0)


def test_our_signed_frames_follow_the_specification_byte_by_byte() -> None:
    ours = Ours(link_id=7)
    frame = ours.codec.encode(text("Vine: ready"), 1)
    payload = b"\x06Vine: ready"
    assert frame == signed_by_hand(payload, NOW + 1, link_id=7, component=191)
    assert frame == bytes.fromhex(
        "fd 0c 0100 00 01bf fd0000 0656696e653a207265616479 4ef2 07 01703d18a521 6aa1d13f9e9a"
    )


def test_frames_signed_by_hand_and_by_pymavlink_are_accepted() -> None:
    ours, theirs = Ours(), mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    theirs.signing.secret_key, theirs.signing.timestamp, theirs.signing.sign_outgoing = KEY, NOW, True
    assert ours.receive(Peer().say("by hand")) == ["by hand"]
    assert ours.receive(text("by pymavlink").pack(theirs)) == ["by pymavlink"]
    (message,) = theirs.parse_buffer(ours.codec.encode(text("Vine: hello"), 1))
    assert (message.text, message.get_signed()) == ("Vine: hello", True)
    assert ours.refused == RefusedFrames()


@pytest.mark.parametrize("name", ["px4_mission.tlog", "px4_vine_mission.tlog"])
def test_frames_that_a_real_px4_signed_are_accepted(name: str) -> None:
    # It signs with a key of zeros until it gets one, and counts timestamps from its start.
    signing = Signing(bytes(32))
    codec = MavlinkCodec(0, 191, signing)
    frames = [frame for _, frame in TlogReader(RECORDINGS / name).frames()]
    unsigned = sum(not frame[2] & 1 for frame in frames)
    known = sum(int.from_bytes(frame[7:10], "little") in mavlink.mavlink_map for frame in frames)
    received = sum(len(codec.decode(frame)) for frame in frames)
    assert signing.refused == RefusedFrames(unsigned=unsigned)
    assert 0 < unsigned < 150
    assert received == known - unsigned
    assert MavlinkCodec(0, 191, Signing(KEY)).decode(b"".join(frames)) == []


def test_each_frame_has_a_timestamp_of_its_own_and_none_behind_the_clock() -> None:
    ours = Ours()
    stamps = []
    for second in range(5):
        ours.signing.advance(NOW_S + second)
        for _ in range(3):
            stamps.append(int.from_bytes(ours.codec.encode(text("x"), 1)[-12:-6], "little"))
    assert stamps == [NOW + second * UNITS_PER_S + i for second in range(5) for i in (1, 2, 3)]


clocks = st.lists(
    st.one_of(
        st.none(),
        st.tuples(
            st.one_of(st.floats(-1e10, 1e10), st.floats(NOW_S - 1e6, NOW_S + 1e6)),
            st.one_of(st.none(), st.floats(0.0, 1e6)),
            st.booleans(),
        ),
        st.integers(0, 2**48 - 1),
    ),
    max_size=60,
)


@given(st.integers(0, 2**47), clocks)
@settings(max_examples=examples(200), deadline=None)
def test_with_any_clock_no_timestamp_is_used_twice_on_one_link_id(
    kept: int, steps: list[tuple[float, float | None, bool] | int | None]
) -> None:
    signing, at_s = Signing(KEY, memory=SigningMemory(kept)), 0.0
    last = {0: kept}
    codec = MavlinkCodec(1, 191, signing)
    for step in steps:
        if step is None:
            stamp = signing.next_timestamp()
            assert stamp > last.get(signing.link_id, -1)
            last[signing.link_id] = stamp
        elif isinstance(step, int):
            codec.decode(signed_by_hand(b"\x06", step))
        else:
            unix_time_s, elapsed_s, synchronised = step
            at_s += elapsed_s or 0.0
            signing.advance(unix_time_s, None if elapsed_s is None else at_s, synchronised)
            assert signing.timestamp <= signing._latest
        assert 0 <= signing.timestamp <= 2**47 + len(steps)


def test_without_a_clock_the_saved_timestamp_continues() -> None:
    # A Raspberry Pi starts with an old time; a minute later its clock is right.
    ours = Ours(timestamp=NOW, clock_s=0.0)
    assert ours.signing.next_timestamp() == NOW + 1
    ours.signing.advance(NOW_S + 90)
    assert ours.signing.next_timestamp() == NOW + 90 * UNITS_PER_S + 1


def test_without_a_clock_the_time_is_the_autopilots() -> None:
    ours = Ours(clock_s=None)
    assert ours.receive(Peer().say("I have GPS")) == ["I have GPS"]
    assert ours.signing.next_timestamp() == NOW + 2


def test_unsigned_frames_are_refused_of_both_versions() -> None:
    ours, stranger = Ours(), mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    assert ours.receive(text("obey").pack(stranger)) == []
    assert ours.receive(text("obey").pack(stranger, force_mavlink1=True)) == []
    assert ours.refused == RefusedFrames(unsigned=2)


def test_messages_that_the_dialect_lacks_are_refused_as_well() -> None:
    ours, peer = Ours(), Peer()
    ours.receive(peer.say("hello"))
    unknown = bytearray(text("x").pack(mavlink.MAVLink(None, srcSystem=1, srcComponent=1)))
    unknown[4], unknown[7:10] = 90, (50_000).to_bytes(3, "little")
    assert ours.receive(bytes(unknown) + peer.say("again")) == ["again"]
    assert ours.refused == RefusedFrames(unsigned=1)
    assert ours.codec.lost_frames == 0  # not even its sequence number was used


def test_radio_status_of_a_telemetry_radio_is_accepted() -> None:
    ours = Ours()
    status = mavlink.MAVLink_radio_status_message(200, 200, 90, 30, 30, 0, 0)
    radio = mavlink.MAVLink(None, srcSystem=51, srcComponent=68)
    assert [m.get_type() for m in ours.codec.decode(status.pack(radio))] == ["RADIO_STATUS"]
    # A RADIO_STATUS in the autopilot's name is not from a radio; other messages of a radio are not accepted.
    assert ours.codec.decode(status.pack(mavlink.MAVLink(None, srcSystem=1, srcComponent=1))) == []
    assert ours.codec.decode(text("obey").pack(radio)) == []
    assert ours.refused == RefusedFrames(unsigned=2)


def test_a_frame_with_one_changed_bit_is_refused() -> None:
    frame = Peer().say("ACC")
    for bit in range(8 * len(frame)):
        changed = bytearray(frame)
        changed[bit // 8] ^= 1 << bit % 8
        assert Ours().receive(bytes(changed)) == [], bit


@given(st.lists(st.one_of(st.binary(max_size=80), st.text("abc", max_size=20)), max_size=12))
@settings(max_examples=examples(100), deadline=None)
def test_random_bytes_never_raise_and_are_never_accepted(parts: list[bytes | str]) -> None:
    ours, peer = Ours(), Peer()
    texts_sent = [part for part in parts if isinstance(part, str)]
    received = [
        words for part in parts for words in ours.receive(part if isinstance(part, bytes) else peer.say(part))
    ]
    # Noise may look like a frame of a message that the dialect lacks, and hide good frames.
    received += ours.receive(b"".join(peer.say("last") for _ in range(20)))
    assert set(received) <= {*texts_sent, "last"}
    assert received[-1] == "last"


def test_another_key_is_refused() -> None:
    ours, peer = Ours(), Peer()
    assert ours.receive(peer.say("obey", key=bytes(32))) == []
    assert ours.refused == RefusedFrames(forged=1)


def test_a_forged_frame_of_the_far_future_does_not_lock_out_the_real_sender() -> None:
    ours, attacker, peer = Ours(), Peer(NOW + 1000 * MINUTE), Peer()
    assert ours.receive(attacker.say("obey", key=b"x" * 32)) == []
    assert ours.signing.timestamp == NOW
    assert ours.receive(peer.say("hello")) == ["hello"]


def test_a_frame_is_refused_when_it_is_sent_again() -> None:
    ours, peer = Ours(), Peer()
    frames = [peer.say(f"line {i}") for i in range(300)]
    assert len(ours.receive(b"".join(frames))) == 300
    dice = random.Random(1)
    dice.shuffle(frames)
    assert ours.receive(b"".join(frames)) == []
    assert ours.refused.replayed + ours.codec.repeated_frames == 300
    assert ours.refused.replayed >= 260  # all but the copies of the last few, which routers also make


def test_copies_that_a_network_makes_are_no_attack() -> None:
    ours, peer = Ours(), Peer()
    first, second = peer.say("one"), peer.say("two")
    assert ours.receive(first + second + first + second) == ["one", "two"]
    assert ours.codec.repeated_frames == 2
    assert ours.refused == RefusedFrames()


def test_our_own_frames_that_come_back_are_no_attack() -> None:
    ours = Ours()
    sent = b"".join(ours.codec.encode(text(f"Vine: {i}"), 1) for i in range(50))
    assert ours.receive(sent + sent) == []
    assert ours.codec.echoes == 100
    assert ours.refused == RefusedFrames()


@pytest.mark.parametrize(("age_s", "received"), [(59, True), (61, False), (3600, False), (-3600, True)])
def test_a_new_stream_may_lag_by_a_minute(age_s: int, received: bool) -> None:
    ours = Ours()
    assert ours.receive(Peer(NOW - age_s * UNITS_PER_S).say("hello")) == (["hello"] if received else [])
    assert ours.refused.replayed == (not received)


def test_a_known_stream_may_lag_by_any_time() -> None:
    ours, slow = Ours(), Peer()
    assert ours.receive(slow.say("one")) == ["one"]
    ours.signing.advance(NOW_S + 10_000)
    assert ours.receive(slow.say("two")) == ["two"]


def test_an_autopilot_with_a_slow_clock_is_accepted_after_it_received_us() -> None:
    # PX4, too, counts timestamps from its start. It continues from the largest that it has received.
    ours, px4 = Ours(), Peer(timestamp=2581)
    assert ours.receive(px4.say("hello")) == []
    heartbeat = ours.codec.encode(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 3, 3), 1)
    px4.timestamp = int.from_bytes(heartbeat[-12:-6], "little")
    assert ours.receive(px4.say("hello")) == ["hello"]


def test_links_and_components_are_streams_of_their_own() -> None:
    ours = Ours()
    ahead, behind = Peer(NOW + 10 * MINUTE, link_id=1), Peer(NOW + 9 * MINUTE + MINUTE // 2, link_id=2)
    other = Peer(NOW + 9 * MINUTE + MINUTE // 2, component=154)
    assert ours.receive(ahead.say("a") + behind.say("b") + other.say("c")) == ["a", "b", "c"]


def test_streams_without_end_do_not_fill_the_memory_nor_take_the_autopilots_place() -> None:
    ours, autopilot = Ours(), Peer()
    old = autopilot.say("hello")
    assert ours.receive(old) == ["hello"]
    assert ours.receive(b"".join(autopilot.say(f"{i}") for i in range(40)))
    for number in range(3 * MAX_STREAMS):
        ours.receive(Peer(NOW, system=2 + number % 200, link_id=number % 250).say("hello"))
    assert len(ours.signing._streams) <= MAX_STREAMS
    # Without free memory it cannot be known that they are new.
    assert ours.refused.replayed == 2 * MAX_STREAMS + 1
    assert ours.receive(old) == []
    assert ours.receive(autopilot.say("still here")) == ["still here"]


def test_silent_streams_make_room_and_their_old_frames_stay_refused() -> None:
    ours = Ours()
    frames = [Peer(NOW, system=2 + number).say("hello") for number in range(MAX_STREAMS)]
    assert len(ours.receive(b"".join(frames))) == MAX_STREAMS
    ours.signing.advance(NOW_S + 120)
    assert ours.receive(Peer(NOW + 2 * MINUTE, system=200).say("new")) == ["new"]
    assert len(ours.signing._streams) == 1
    for frame in frames:
        ours.codec._senders.clear()  # as if their sequence numbers did not show these copies
        assert ours.receive(frame) == []


IN_2040_S = 2_208_988_800.0
IN_2040 = int((IN_2040_S - UNIX_TIME_OF_ZERO_S) * UNITS_PER_S)
HOUR = 60 * MINUTE


@pytest.mark.parametrize("synchronised", [True, False])
def test_one_frame_of_2040_blocks_no_other_sender(synchronised: bool) -> None:
    ours = Ours(clock_s=None)
    ours.signing.advance(NOW_S, 0.0, synchronised)
    station, autopilot = Peer(IN_2040, system=255, component=190), Peer()
    assert ours.receive(station.say("what year is it?") + station.say("again")) == []
    assert ours.refused == RefusedFrames(ahead=2)
    assert ours.receive(autopilot.say("hello")) == ["hello"]
    assert ours.receive(Peer(NOW, system=254).say("the right time")) == ["the right time"]
    assert ours.signing.next_timestamp() < NOW + MINUTE
    assert ours.signing.memory.timestamp < NOW + MINUTE
    assert ours.signing.news == ["255/190 signs 4849 days ahead of our clock"]


@pytest.mark.parametrize(("hours", "received"), [(14, True), (23, True), (25, False)])
def test_a_wrong_time_zone_is_accepted_and_changes_no_limit(hours: int, received: bool) -> None:
    ours = Ours(clock_s=None)
    ours.signing.advance(NOW_S, 0.0, synchronised=True)
    assert ours.receive(Peer(NOW + hours * HOUR, system=255).say("far east")) == (
        ["far east"] if received else []
    )
    assert ours.receive(Peer(NOW - 50 * UNITS_PER_S).say("here")) == ["here"]


def test_a_saved_timestamp_of_the_far_future_is_dropped_and_others_accept_us_again() -> None:
    poisoned = SigningMemory(IN_2040, 191, (((0, 255, 190), IN_2040), ((3, 1, 1), NOW - HOUR)))
    signing = Signing(KEY, 191, poisoned)
    pilot = mavlink.MAVLink(None, srcSystem=255, srcComponent=230)
    pilot.signing.secret_key, pilot.signing.timestamp = KEY, NOW
    codec = MavlinkCodec(1, 191, signing)
    assert pilot.parse_buffer(codec.encode(text("in 2040"), 1))[0].get_signed()
    pilot.signing.timestamp = NOW  # it was restarted, but knows our stream, like an autopilot
    signing.advance(NOW_S, 0.0)
    assert signing.news == ["signing clock was 4849 days ahead: corrected"]
    assert signing.memory == SigningMemory(NOW, 192, (((3, 1, 1), NOW - HOUR),))
    assert pilot.parse_buffer(codec.encode(text("Vine: back"), 1))[0].get_signed()
    assert [m.text for m in codec.decode(Peer(NOW, system=255, component=190, link_id=0).say("hello"))] == [
        "hello"
    ]


@pytest.mark.parametrize("synchronised", [True, False])
def test_a_jump_of_our_own_clock_is_not_followed(synchronised: bool) -> None:
    signing = Signing(KEY)
    signing.advance(NOW_S, 100.0, synchronised)
    for second in range(1, 6):
        signing.advance(IN_2040_S + second, 100.0 + second, synchronised)
        assert abs(signing.next_timestamp() - NOW - second * UNITS_PER_S) < 10
    assert signing.news == ["own clock jumped +4849 days: ignored"]
    signing.advance(NOW_S + 6, 106.0, synchronised)
    assert abs(signing.next_timestamp() - NOW - 6 * UNITS_PER_S) < 10
    assert len(signing.news) == 1 and signing.link_id == 0


def test_a_clock_that_jumps_back_far_does_not_shut_the_autopilot_out() -> None:
    ours = Ours(clock_s=None)
    ours.signing.advance(NOW_S, 0.0, synchronised=True)
    ours.signing.advance(0.0, 1.0, synchronised=True)
    assert ours.receive(Peer(NOW + MINUTE).say("hello")) == ["hello"]


def test_the_first_synchronisation_is_followed_and_corrects_a_timestamp_that_was_ahead() -> None:
    # An unsynchronised clock may be a year behind. Only a synchronised clock shows a wrong date.
    ours = Ours(clock_s=None)
    ours.signing.advance(NOW_S - 3 * 86400, 0.0)
    year_ahead = Peer(NOW + 365 * 24 * HOUR, system=255)
    assert ours.receive(year_ahead.say("next year")) == ["next year"]
    ours.signing.advance(NOW_S, 1.0, synchronised=True)
    assert ours.signing.news == ["signing clock was 365 days ahead: corrected"]
    assert ours.signing.timestamp == NOW
    assert ours.receive(Peer(NOW).say("hello")) == ["hello"]
    assert ours.receive(year_ahead.say("next year again")) == []


def test_a_computer_that_starts_in_the_past_follows_its_autopilot() -> None:
    ours = Ours(clock_s=None)
    ours.signing.advance(NOW_S - 100 * 86400, 0.0)
    assert ours.receive(Peer(NOW).say("I have GPS")) == ["I have GPS"]
    assert ours.signing.next_timestamp() > NOW


def test_frames_recorded_before_a_restart_are_refused_after_it() -> None:
    before, peer = Ours(), Peer()
    recorded = [peer.say(f"bend {i}") for i in range(20)]
    assert len(before.receive(b"".join(recorded))) == 20
    after = Signing(KEY, memory=before.signing.memory)
    after.advance(NOW_S + 2.0)
    codec = MavlinkCodec(1, 191, after)
    assert codec.decode(b"".join(recorded)) == []
    assert after.refused == RefusedFrames(replayed=20)
    assert [m.text for m in codec.decode(peer.say("live"))] == ["live"]


def test_after_a_crash_only_unsaved_frames_can_be_replayed_and_only_before_their_sender_sends() -> None:
    before, peer = Ours(), Peer()
    early = [peer.say(f"early {i}") for i in range(5)]
    before.receive(b"".join(early))
    memory = before.signing.memory
    late = [peer.say(f"late {i}") for i in range(5)]
    before.receive(b"".join(late))
    crashed = Signing(KEY, memory=memory)
    crashed.advance(NOW_S + 2.0)
    codec = MavlinkCodec(1, 191, crashed)
    assert codec.decode(b"".join(early)) == []
    assert [m.text for m in codec.decode(late[0])] == ["late 0"]
    assert [m.text for m in codec.decode(peer.say("live"))] == ["live"]
    assert codec.decode(b"".join(late)) == []


sendings = st.lists(
    st.tuples(st.sampled_from(["live", "copy", "restart", "time"]), st.integers(0, 2), st.integers(0, 400)),
    max_size=60,
)


@given(sendings)
@settings(max_examples=examples(200), deadline=None)
def test_no_frame_is_accepted_twice_over_any_restarts(steps: list[tuple[str, int, int]]) -> None:
    signing, now_s = Signing(KEY), NOW_S
    signing.advance(now_s, 0.0, synchronised=True)
    codec, peers, frames, accepted = (
        MavlinkCodec(1, 191, signing),
        [Peer(NOW, 1 + i) for i in range(3)],
        [b""],
        [],
    )
    for what, number, value in steps:
        if what == "time":
            now_s += value
            signing.advance(now_s, now_s - NOW_S, synchronised=True)
        elif what == "restart":
            signing = Signing(KEY, memory=signing.memory)
            signing.advance(now_s, 0.0, synchronised=True)
            codec = MavlinkCodec(1, 191, signing)
        else:
            if what == "live":
                peer = peers[number]
                peer.timestamp = max(peer.timestamp, int((now_s - UNIX_TIME_OF_ZERO_S) * UNITS_PER_S))
                frames.append(peer.say(f"{len(frames)}"))
            frame = frames[-1] if what == "live" else frames[value % len(frames)]
            texts = [message.text for message in codec.decode(frame)]
            assert bool(texts) >= (what == "live")
            accepted += texts
    assert len(accepted) == len(set(accepted))


def test_a_key_has_32_bytes() -> None:
    with pytest.raises(ValueError, match="32 bytes, not 5"):
        Signing(b"short")


Kind = Literal["ardupilot", "px4"]


def signed_flight(kind: Kind, key: bytes) -> tuple[Snapshot, RefusedFrames]:
    """A core that signs with `key`, and an autopilot that signs with `KEY` by pymavlink's code."""
    flight, signing = SimulatedFlight(config.default(), FakeAutopilot(kind, signing_key=KEY)), Signing(key)
    flight._codec = MavlinkCodec(0, 191, signing)
    flight.run(6.0)
    flight.autopilot.reboot()
    flight.run(14.0)
    return flight.core.snapshot(14.0), signing.refused


@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
def test_an_autopilot_with_our_key_serves_us_before_and_after_it_reboots(kind: Kind) -> None:
    seen, refused = signed_flight(kind, KEY)
    assert (seen.vehicle, seen.rc) == (f"{kind} 1", "good")
    assert refused == RefusedFrames()


@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
def test_an_autopilot_with_another_key_is_not_served(kind: Kind) -> None:
    seen, refused = signed_flight(kind, b"another key of thirty-two bytes.")
    assert seen.vehicle == "not found"
    assert refused.forged > 5
