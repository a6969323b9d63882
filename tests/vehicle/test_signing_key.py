"""The key file and the timestamp file: accepted and refused contents, and restarts."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from examples import examples
from flying_vines.vehicle.mavlink.signing import (
    UNITS_PER_S,
    UNIX_TIME_OF_ZERO_S,
    Signing,
    SigningKeyError,
    SigningMemory,
    TimestampFile,
    read_key,
)

KEY = bytes(range(32))


def key_file(folder: Path, content: bytes, mode: int = 0o600) -> Path:
    path = folder / "signing.key"
    path.write_bytes(content)
    path.chmod(mode)
    return path


@pytest.mark.parametrize(
    "content",
    [KEY, KEY.hex().encode(), KEY.hex().upper().encode() + b"\n", b"  " + KEY.hex().encode() + b"\r\n"],
)
def test_a_key_in_bytes_or_digits(tmp_path: Path, content: bytes) -> None:
    assert read_key(key_file(tmp_path, content)) == KEY


def test_a_key_may_begin_or_end_with_what_looks_like_a_line_end(tmp_path: Path) -> None:
    key = b"\n" + bytes(range(200, 230)) + b"\n"
    assert read_key(key_file(tmp_path, key)) == key


@pytest.mark.parametrize(
    "line",
    [
        "passphrase: correct horse battery",
        "passphrase:correct horse battery\n",
        "passphrase:  correct horse battery \r\n",
    ],
)
def test_a_passphrase_becomes_a_key_as_in_ground_stations(tmp_path: Path, line: str) -> None:
    assert read_key(key_file(tmp_path, line.encode())) == hashlib.sha256(b"correct horse battery").digest()


def test_a_passphrase_in_any_language(tmp_path: Path) -> None:
    path = key_file(tmp_path, "passphrase: grünes Gemüse".encode())
    assert read_key(path) == hashlib.sha256("grünes Gemüse".encode()).digest()


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\n",
        KEY[:31],
        KEY + b"x",
        KEY.hex().encode()[:-1],
        b"correct horse battery",
        b"a line of just 32 characters....",
    ],
)
def test_an_invalid_key_is_refused_and_not_shown(tmp_path: Path, content: bytes) -> None:
    path = key_file(tmp_path, content)
    with pytest.raises(SigningKeyError) as refused:
        read_key(path)
    assert str(refused.value) == (
        f"{path}: no signing key in the file: write 64 hexadecimal digits, 32 raw bytes, or a line "
        '"passphrase: ..."'
    )


def test_a_short_passphrase_is_refused(tmp_path: Path) -> None:
    path = key_file(tmp_path, b"passphrase: vine")
    with pytest.raises(SigningKeyError, match=r"the passphrase has less than 8 characters$"):
        read_key(path)


@pytest.mark.parametrize("content", [bytes(32), b"0" * 64])
def test_a_key_of_zeros_is_refused(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(SigningKeyError, match="the key is all zeros"):
        read_key(key_file(tmp_path, content))


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o620, 0o777])
def test_a_key_that_others_may_read_or_change_is_refused(tmp_path: Path, mode: int) -> None:
    path = key_file(tmp_path, KEY, mode)
    with pytest.raises(SigningKeyError) as refused:
        read_key(path)
    assert str(refused.value) == f"{path}: others may read or change the signing key: chmod 600 {path}"


def test_a_missing_file_and_a_folder_are_named(tmp_path: Path) -> None:
    with pytest.raises(SigningKeyError, match=r"gone\.key: .* cannot be read: No such .*; put it there: 64"):
        read_key(tmp_path / "gone.key")
    with pytest.raises(SigningKeyError, match="Is a directory; put it there"):
        read_key(tmp_path)
    with pytest.raises(SigningKeyError, match="cannot be read: Not a directory"):
        read_key(key_file(tmp_path, KEY) / "below")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "signing.timestamp"


def test_a_first_start_has_no_saved_timestamp_and_saves_at_once(file: Path) -> None:
    keeper = TimestampFile(file)
    assert keeper.load() == (SigningMemory(), "")
    assert keeper.due(5)
    keeper.save(SigningMemory(5))
    assert not keeper.due(6)


def test_a_restart_continues_a_minute_later_and_saves_at_once(file: Path) -> None:
    TimestampFile(file).save(SigningMemory(36_000_000_000_000))
    again = TimestampFile(file)
    assert again.load() == (SigningMemory(36_000_000_000_000 + 60 * UNITS_PER_S, 0), "")
    assert again.due(36_000_006_000_000)


def test_the_timestamp_is_saved_every_half_minute_and_when_the_clock_jumped(file: Path) -> None:
    keeper = TimestampFile(file)
    saved = []
    for second in [*range(100), *range(5000, 5060)]:
        if keeper.due(second * UNITS_PER_S):
            keeper.save(SigningMemory(second * UNITS_PER_S))
            saved.append(second)
    assert saved == [0, 30, 60, 90, 5000, 5030]


@pytest.mark.parametrize("clock_s", [0.0, 1.7e9])
def test_no_timestamp_is_used_twice_over_any_crashes(file: Path, clock_s: float) -> None:
    # Without a clock only sent frames increase the timestamp.
    used: list[int] = []
    for seconds in (0, 1, 29, 31, 45, 3, 0, 100):
        keeper = TimestampFile(file)
        signing = Signing(KEY, memory=keeper.load()[0])
        for _ in range(20 * seconds + 1):
            signing.advance(clock_s)
            clock_s += 0.05 if clock_s else 0.0
            used.append(signing.next_timestamp())
            if keeper.due(signing.timestamp):
                keeper.save(signing.memory)
    assert used == sorted(set(used))


def test_a_clock_that_was_set_back_changes_nothing(file: Path) -> None:
    TimestampFile(file).save(SigningMemory(36_000_000_000_000))
    signing = Signing(KEY, memory=TimestampFile(file).load()[0])
    signing.advance(UNIX_TIME_OF_ZERO_S + 1.0)
    assert signing.next_timestamp() == 36_000_006_000_001


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"36000000000000",
        b"036000000000000",
        b"\xff\xfe",
        b"03600000000000x\n",
        b"9" * 15 + b"\n",
        b"036000000000000 191\n191 001 001 03600000000",
        b"036000000000000 191\n191 001 001 " + b"9" * 15 + b"\n",
    ],
)
def test_a_damaged_file_leaves_the_clock_alone_and_is_reported(file: Path, content: bytes) -> None:
    file.write_bytes(content)
    assert TimestampFile(file).load() == (
        SigningMemory(),
        f"{file}: damaged; the signing timestamp continues from the clock alone",
    )


def test_the_file_of_an_earlier_version_is_continued(file: Path) -> None:
    file.write_text("036000000000000\n")
    assert TimestampFile(file).load() == (SigningMemory(36_000_006_000_000), "")


@given(
    st.integers(0, 2**47),
    st.integers(0, 255),
    st.dictionaries(st.tuples(*[st.integers(0, 255)] * 3), st.integers(0, 2**47), max_size=64),
)
@settings(
    max_examples=examples(50), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_the_file_is_read_as_it_was_written(
    file: Path, timestamp: int, link_id: int, streams: dict[tuple[int, int, int], int]
) -> None:
    memory = SigningMemory(timestamp, link_id, tuple(streams.items()))
    TimestampFile(file).save(memory)
    again, problem = TimestampFile(file).load()
    assert (again, problem) == (SigningMemory(timestamp + 60 * UNITS_PER_S, link_id, memory.streams), "")


def test_a_corrected_clock_is_saved_at_once(file: Path) -> None:
    keeper = TimestampFile(file)
    keeper.save(SigningMemory(36_000_000_000_000))
    assert keeper.due(35_000_000_000_000)


def test_the_file_is_written_as_a_whole_or_not_at_all(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keeper = TimestampFile(file)
    keeper.save(SigningMemory(36_000_000_000_000))

    def power_cut(descriptor: int) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "fsync", power_cut)
    with pytest.raises(SigningKeyError, match=r"signing timestamp cannot be written: Input/output error"):
        keeper.save(SigningMemory(37_000_000_000_000))
    assert TimestampFile(file).load()[0].timestamp == 36_000_006_000_000


def test_a_missing_folder_is_made_and_a_failure_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "none" / "signing.timestamp"
    TimestampFile(path).save(SigningMemory(7))
    assert path.read_text() == "000000000000007 000\n"
    with pytest.raises(SigningKeyError, match="cannot be written: Not a directory"):
        TimestampFile(path / "below" / "signing.timestamp").save(SigningMemory(1))
