"""Recordings: the real ones to the last byte, and all kinds of damage."""

from __future__ import annotations

import random
import struct
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from examples import examples
from flying_vines.vehicle.mavlink.tlog import TlogError, TlogReader

RECORDINGS = Path(__file__).parents[1] / "data" / "recordings"
FRAMES = {
    "ardupilot_hidden_rc_loss": 5087,
    "ardupilot_override_and_late_texts": 7003,
    "ardupilot_vine_mission": 2388,
    "mission_do_items": 7948,
    "px4_crsf_loss": 7467,
    "px4_mission": 5251,
    "px4_sbus_failsafe": 9886,
    "px4_vine_mission": 3124,
    "rc_switch": 2870,
    "reboot": 1744,
}
START_US = 1_795_211_476_734_000

Record = tuple[float, bytes]


def records(count: int, version_1: bool = False, signed: bool = False) -> list[tuple[int, bytes]]:
    """(time in us, frame), a tenth of a second apart."""
    mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    if signed:
        mav.signing.secret_key, mav.signing.sign_outgoing = b"k" * 32, True
    made = []
    for i in range(count):
        message = mavlink.MAVLink_statustext_message(6, f"line {i}".encode(), 0, 0)
        made.append((START_US + 100_000 * i, bytes(message.pack(mav, force_mavlink1=version_1))))
        mav.seq = (mav.seq + 1) % 256
    return made


def raw(made: list[tuple[int, bytes]]) -> bytes:
    return b"".join(struct.pack(">Q", time_us) + frame for time_us, frame in made)


def read(path: Path, data: bytes) -> tuple[list[Record], int]:
    path.write_bytes(data)
    reader = TlogReader(path)
    return list(reader.frames()), reader.skipped_bytes


def as_read(made: list[tuple[int, bytes]]) -> list[Record]:
    return [(time_us / 1e6, frame) for time_us, frame in made]


def test_every_recording_here_is_tried() -> None:
    assert {path.stem for path in RECORDINGS.glob("*.tlog")} == set(FRAMES)


@pytest.mark.parametrize("name", FRAMES)
def test_real_recordings_are_read_to_the_last_byte(name: str) -> None:
    path = RECORDINGS / f"{name}.tlog"
    reader = TlogReader(path)
    found = list(reader.frames())
    assert len(found) == FRAMES[name]
    assert reader.skipped_bytes == 0
    assert sum(8 + len(frame) for _, frame in found) == path.stat().st_size
    times_s = [time_s for time_s, _ in found]
    assert times_s == sorted(times_s)
    assert 60 < times_s[-1] - times_s[0] < 300


@pytest.mark.parametrize(("version_1", "signed"), [(False, False), (True, False), (False, True)])
def test_every_kind_of_frame(tmp_path: Path, version_1: bool, signed: bool) -> None:
    made = records(20, version_1, signed)
    assert read(tmp_path / "x.tlog", raw(made)) == (as_read(made), 0)


def test_truncated_at_every_byte_of_the_last_record(tmp_path: Path) -> None:
    made = records(4)
    whole, kept = raw(made), raw(made[:3])
    for size in range(len(kept) + 1, len(whole)):
        found, skipped = read(tmp_path / "x.tlog", whole[:size])
        assert found == as_read(made[:3])
        assert skipped == size - len(kept)


def test_a_real_recording_truncated_anywhere_in_its_end(tmp_path: Path) -> None:
    data = (RECORDINGS / "reboot.tlog").read_bytes()[-2000:]
    whole, _ = read(tmp_path / "x.tlog", data)
    for cut in range(1, 60):
        found, _ = read(tmp_path / "x.tlog", data[:-cut])
        assert found == whole[: len(found)]
        assert len(found) >= len(whole) - 3


@given(garbage=st.binary(min_size=1, max_size=400), at=st.integers(0, 10))
@settings(max_examples=examples(200), deadline=None)
def test_garbage_between_records_costs_no_record_around_it(
    tmp_path_factory: pytest.TempPathFactory, garbage: bytes, at: int
) -> None:
    made = records(10)
    path = tmp_path_factory.getbasetemp() / "garbage.tlog"
    found, skipped = read(path, raw(made[:at]) + garbage + raw(made[at:]))
    assert found == as_read(made)
    assert skipped == len(garbage)


@pytest.mark.parametrize("claimed", [30, 50, 100, 150, 200, 240])
def test_bytes_that_look_like_a_record_hide_no_record(tmp_path: Path, claimed: int) -> None:
    made = records(12)
    fake = struct.pack(">Q", START_US) + bytes((0xFD, claimed, 0, 0, 9, 1, 1, 0, 0, 0)) + b"?" * 15
    assert read(tmp_path / "x.tlog", raw(made[:3]) + fake + raw(made[3:])) == (as_read(made), len(fake))


def test_damage_within_a_record_costs_no_more_than_its_length_byte_can_claim(tmp_path: Path) -> None:
    made, dice = records(30), random.Random(1)
    whole = raw(made)
    middle = len(raw(made[:15]))
    for _ in range(300):
        damaged = bytearray(whole)
        at = middle + dice.randrange(len(raw(made[15:16])))
        damaged[at] ^= 1 + dice.randrange(255)
        found, _ = read(tmp_path / "x.tlog", bytes(damaged))
        intact = as_read(made[:15] + made[16:])
        assert [record for record in found if record in intact][:14] == as_read(made[:14])
        assert found[-6:] == as_read(made[-6:])


@given(st.binary(max_size=600))
@settings(max_examples=examples(100), deadline=None)
def test_any_file_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "any.tlog"
    try:
        found, skipped = read(path, data)
    except TlogError:
        return
    assert sum(8 + len(frame) for _, frame in found) + skipped == len(data)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "it is empty"),
        (b"\0" * 500, "it is all zeros"),
        (b"QGC WPL 110\n0\t1\t0\t16\n" * 30, "it is a mission"),
        (raw(records(1))[:-1], "is it a .tlog?"),
        (b"".join(frame for _, frame in records(40)), "it is a raw stream"),
        (b"".join(frame for _, frame in records(40))[5:], "it is a raw stream"),
        (b"\xa3\x95\x80\x80\x59FMT\0BBnNZ" + bytes(range(256)) * 40, "an ArduPilot DataFlash log"),
        (b"ULog\x01\x12\x35\x01" + bytes(range(256)) * 40, "a PX4 log"),
    ],
)
def test_a_file_without_a_frame_is_no_recording(data: bytes, says: str, tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    with pytest.raises(TlogError, match=r"flight\.tlog: no MAVLink frame in the file") as caught:
        read(path, data)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_cannot_be_read_gives_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(TlogError, match="no such file"):
        TlogReader(tmp_path / "nowhere.tlog")
    with pytest.raises(TlogError, match="cannot be read: Is a directory"):
        TlogReader(tmp_path)
