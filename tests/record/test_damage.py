"""Cut or damaged logs are read as far as they are intact."""

from __future__ import annotations

import random
from collections import Counter
from pathlib import Path

import pytest
from recorded_flight import one_bend, recorded_until_killed

from flying_vines.record.reader import FlightLog, LogEntry, LogError


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return one_bend(tmp_path_factory.mktemp("flown")) / "flight.mcap"


@pytest.fixture(scope="module")
def entries(whole: Path) -> list[LogEntry]:
    log = FlightLog(whole)
    entries = list(log.entries())
    assert not log.damage
    return entries


def test_cut_off_anywhere_it_is_read_up_to_there(
    whole: Path, entries: list[LogEntry], tmp_path: Path
) -> None:
    data, cut = whole.read_bytes(), tmp_path / "cut.mcap"
    chance = random.Random(1)
    counts = []
    for size in sorted(chance.sample(range(20_000, len(data)), 60)):
        cut.write_bytes(data[:size])
        log = FlightLog(cut)
        found = list(log.entries())
        assert found == entries[: len(found)]
        assert "is incomplete" in log.damage
        counts.append(len(found))
    assert counts == sorted(counts) and counts[-1] > 0.9 * len(entries) and len(set(counts)) > 10


def test_an_incomplete_log_has_no_summary(whole: Path, tmp_path: Path) -> None:
    """Some cuts leave bytes that look like a footer: its opcode, and zeros for a checksum of nothing."""
    data, cut = whole.read_bytes(), tmp_path / "cut.mcap"
    begins_behind_itself = b"\x02" + bytes(15) + b"\x7f" + bytes(12)
    half, magic = data[: len(data) // 2], data[-8:]
    for end in (data[len(data) // 2 : -1], begins_behind_itself + bytes(8), begins_behind_itself + magic):
        cut.write_bytes(half + end)
        log = FlightLog(cut)
        assert list(log.entries())
        assert ("is incomplete" in log.damage) == (not end.endswith(magic))


def test_a_damaged_place_costs_half_a_second(whole: Path, entries: list[LogEntry], tmp_path: Path) -> None:
    data, hurt = whole.read_bytes(), tmp_path / "hurt.mcap"
    chance = random.Random(2)
    lost = 0
    for _ in range(60):
        damaged = bytearray(data)
        damaged[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
        hurt.write_bytes(damaged)
        log = FlightLog(hurt)
        found = list(log.entries())
        missing = sorted((Counter(entries) - Counter(found)).elements(), key=lambda entry: entry.unix_ns)
        assert len(found) + len(missing) == len(entries)
        if missing:
            lost += 1
            assert missing[-1].unix_ns - missing[0].unix_ns <= 0.6e9
            assert f"{len(missing)} damaged messages" in log.damage or log.cut_off
    assert lost > 20


def test_many_damaged_places_and_noise(whole: Path, entries: list[LogEntry], tmp_path: Path) -> None:
    data, hurt = bytearray(whole.read_bytes()), tmp_path / "hurt.mcap"
    chance = random.Random(3)
    for _ in range(5):
        at = chance.randrange(len(data))
        data[at : at + 100] = chance.randbytes(300)
    hurt.write_bytes(data)
    found = list(FlightLog(hurt).entries())
    assert 0 < len(found) < len(entries)
    assert set(found) < set(entries)


def test_the_names_of_topics_are_in_more_than_one_place(
    whole: Path, entries: list[LogEntry], tmp_path: Path
) -> None:
    data, hurt = bytearray(whole.read_bytes()), tmp_path / "hurt.mcap"
    data[data.index(b"zstd") + 500] ^= 1
    hurt.write_bytes(data)
    found = list(FlightLog(hurt).entries())
    assert found and found == entries[-len(found) :]


def test_a_file_that_is_not_a_log_gives_one_line(tmp_path: Path) -> None:
    cases = {"nothing": None, "empty": b"", "noise": bytes(range(256)) * 64, "text": b"zstd" * 5000}
    for name, data in cases.items():
        path = tmp_path / f"{name}.mcap"
        if data is not None:
            path.write_bytes(data)
        with pytest.raises(LogError) as error:
            list(FlightLog(path).entries())
        assert str(path) in str(error.value) and "\n" not in str(error.value)


def test_a_killed_recorder_loses_less_than_a_second(tmp_path: Path) -> None:
    for seed in range(2):
        lost = recorded_until_killed(tmp_path / str(seed), seed)
        assert lost.by_kill_s < 1.0
        assert lost.by_power_cut_s < 1.0
