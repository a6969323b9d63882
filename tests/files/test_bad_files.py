"""Every file that a command reads may be anything: each ends with one line and status 2, in bounded memory.

The limits count what is really read and written, not what headers say.
"""

from __future__ import annotations

import os
import resource
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zstandard
from command_line import run

from flying_vines.files import bounded
from flying_vines.files.toml_text import OneLineError, parsed
from flying_vines.record.mcap_file import MAGIC, MAX_CHUNK_BYTES
from flying_vines.record.reader import FlightLog, LogError

MOST_MEMORY_MB = 500
LONGEST_S = 60
LONG_LINE_BYTES = 100_000_000

COMMANDS: dict[str, tuple[str, ...]] = {
    "config.toml": ("config", "check", "FILE"),
    "rig.toml": ("simulate", "--rig", "FILE", "--scenario", "discharge", "--out", "out"),
    "scenario.toml": ("simulate", "--rig", "good-rig.toml", "--scenario", "FILE", "--out", "out"),
    "plan-rig.toml": ("diagnose", "--plan", "FILE"),
    "case.csv": ("diagnose", "FILE"),
    "log.csv": ("import", "FILE"),
    "answers.csv": ("import", "answers.csv"),
    "flight.mcap": ("log", "show", "FILE"),
    "replayed.mcap": ("replay", "FILE"),
    "diagnosed.mcap": ("diagnose", "--from-log", "FILE"),
    "stream.tlog": ("replay", "FILE"),
    "set.toml": ("replay", "good.tlog", "--parameters", "FILE"),
    "flown.waypoints": ("replay", "good.tlog", "--mission", "FILE"),
    "mission.plan": ("mission", "check", "FILE", "--autopilot", "px4"),
    "mission.waypoints": ("mission", "check", "FILE", "--autopilot", "px4"),
    "mission.toml": ("mission", "check", "FILE", "--autopilot", "px4"),
    "pairs.csv": ("vine", "fit", "FILE"),
    "robot.toml": ("design", "--robot", "FILE"),
    "cause.py": ("config", "check", "good.toml", "--cause", "FILE"),
}
"""For each file, the command that reads it."""


def _nothing(path: Path) -> None:
    path.write_bytes(b"")


def _zeros(path: Path) -> None:
    path.write_bytes(bytes(10_000))


def _not_utf8(path: Path) -> None:
    path.write_bytes(b"\xff\xfe\xfa\x80" * 100)


def _folder(path: Path) -> None:
    path.mkdir()


def _fifo(path: Path) -> None:
    os.mkfifo(path)


def _endless(path: Path) -> None:
    path.symlink_to("/dev/zero")


def _long_line(path: Path) -> None:
    path.write_bytes(b"1" * LONG_LINE_BYTES)


def _huge(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(20_000_000_000)


def _deep_arrays(path: Path) -> None:
    path.write_text("x = " + "[" * 100_000)


def _deep_keys(path: Path) -> None:
    path.write_text("a." * 100_000 + "a = 1")


def _deep_json(path: Path) -> None:
    path.write_text('{"fileType": "Plan", "x": ' + "[" * 100_000 + "]" * 100_000 + "}")


def _long_key(path: Path) -> None:
    path.write_text("a" * 900_000 + " = 1")


def _many_digits(path: Path) -> None:
    path.write_text("x = " + "9" * 100_000)


BAD: tuple[Callable[[Path], None], ...] = (
    _nothing, _zeros, _not_utf8, _folder, _fifo, _endless, _long_line, _huge,
    _deep_arrays, _deep_keys, _deep_json, _long_key, _many_digits,
)  # fmt: skip


@pytest.fixture(autouse=True)
def _limited_memory() -> Iterator[None]:
    """A reader without a bound fails here, and does not take the machine's memory."""
    before = resource.getrlimit(resource.RLIMIT_DATA)
    with Path("/proc/self/statm").open() as file:
        used_bytes = int(file.read().split()[5]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_DATA, (used_bytes + MOST_MEMORY_MB * 1_000_000, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_DATA, before)


@pytest.fixture(autouse=True)
def _good_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("good-rig.toml").write_text("[cv]\n")
    Path("good.toml").write_text("[profiles.straight]\nsegments = [{ kind = 'step', to_kPa = 0 }]\n")
    Path("good.tlog").write_bytes(b"")


@pytest.mark.parametrize("make", BAD, ids=lambda make: make.__name__.strip("_"))
@pytest.mark.parametrize("name", COMMANDS)
def test_a_bad_file_ends_with_one_line(
    name: str, make: Callable[[Path], None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / name
    make(path)
    if name == "answers.csv":
        path.rename(path.with_suffix(".answers.toml"))
        path.write_text("time_s,cv\n" + "1.0,2.0\n" * 20)
    command = [str(path) if word == "FILE" else word for word in COMMANDS[name]]
    if make is _nothing and name in ("rig.toml", "plan-rig.toml"):
        return  # an empty rig file is the default rig
    status, _, err = run(capsys, *command)
    assert status == 2, err
    assert err.startswith("flying-vines: ")
    assert err.count("\n") == 1, err
    assert len(err) < 3000
    assert "Traceback" not in err


def chunk(
    data: bytes, compression: bytes = b"zstd", stated: int | None = None, crc: int | None = None
) -> bytes:
    """A chunk of an MCAP whose header may lie."""
    packed = zstandard.compress(data) if compression == b"zstd" else data
    size = len(data) if stated is None else stated
    head = struct.pack("<QQQI", 0, 0, size, zlib.crc32(data) if crc is None else crc)
    body = head + struct.pack("<I", len(compression)) + compression + struct.pack("<Q", len(packed)) + packed
    return b"\x06" + struct.pack("<Q", len(body)) + body


def read_all(path: Path) -> str:
    """The error of a log; fails if there is none."""
    with pytest.raises(LogError) as refused:
        for _ in FlightLog(path).entries():
            pass
    assert "\n" not in str(refused.value)
    return str(refused.value)


def test_a_small_log_that_unpacks_to_gigabytes_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    bomb = chunk(bytes(MAX_CHUNK_BYTES + 1), stated=1000)
    path.write_bytes(MAGIC + bomb)
    assert len(bomb) < 10_000
    assert "no flight log does" in read_all(path)


def test_a_log_of_many_chunks_that_unpack_to_gigabytes_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    path.write_bytes(MAGIC + 200 * chunk(bytes(MAX_CHUNK_BYTES), crc=1))
    assert "no flight log does" in read_all(path)


@pytest.mark.parametrize("crc", [0, 1])
def test_a_frame_of_zstd_that_states_3_GB_takes_no_memory(crc: int, tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    # Frame header: one segment, 8 bytes of content size; then one last block that repeats one byte.
    frame = struct.pack("<IBQ", 0xFD2FB528, 0xE0, 3_000_000_000) + (1 | 1 << 1 | 1000 << 3).to_bytes(
        3, "little"
    )
    body = struct.pack("<QQQI", 0, 0, 3_000_000_000, crc) + struct.pack("<I4sQ", 4, b"zstd", len(frame) + 1)
    body += frame + b"x"
    path.write_bytes(MAGIC + b"\x06" + struct.pack("<Q", len(body)) + body)
    assert "no part of it can be read" in read_all(path)


@pytest.mark.parametrize("compression", [b"lz4", b""])
def test_chunks_that_the_recorder_does_not_write_are_not_unpacked(compression: bytes, tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    path.write_bytes(MAGIC + chunk(bytes(1000), compression, stated=3_000_000_000))
    assert "no part of it can be read" in read_all(path)


@pytest.mark.parametrize("compression", [b"zstd", b"lz4", b""])
def test_a_chunk_in_the_summary_is_not_unpacked(compression: bytes, tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    inner = (
        chunk(bytes(3 * MAX_CHUNK_BYTES), compression) if compression == b"zstd" else chunk(b"x", compression)
    )
    # The regular search must not see the chunk either.
    head = MAGIC + bytes(8)
    footer = b"\x02" + struct.pack("<QQQ", 20, len(head), 0)
    checksum = struct.pack("<I", zlib.crc32(inner + footer))
    path.write_bytes(head + inner + footer + checksum + MAGIC)
    assert "log" in read_all(path)


def test_a_log_larger_than_any_is_refused_at_once(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    _huge(path)
    assert "has more than 1000 MB" in read_all(path)


def test_a_message_of_another_program_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from flying_vines.record.mcap_file import McapFile
    from flying_vines.record.topics import DECISION, NUMBERS, TOPICS

    for content in (b"{}", b"[]", b"nothing", b'{"t": ' + b"[" * 10_000, b'{"t": 1e999}', b'{"t": "x"}'):
        path = tmp_path / "flight.mcap"
        with path.open("wb") as file:
            mcap = McapFile(file, TOPICS, "test")
            mcap.add(NUMBERS[DECISION], 1, content)
            mcap.finish()
        for command in (("log", "show", path), ("log", "plot", path), ("replay", path)):
            status, _, err = run(capsys, *command)
            assert (status, err.count("\n")) == (2, 1), (content[:20], command, err)


@pytest.mark.parametrize("size", [bounded.TEXT_BYTES, bounded.TEXT_BYTES + 1])
def test_the_limit_of_a_text_is_exact(size: int, tmp_path: Path) -> None:
    path = tmp_path / "text"
    path.write_bytes(bytes(size))
    if size <= bounded.TEXT_BYTES:
        assert bounded.read_bytes(path) == bytes(size)
        return
    with pytest.raises(OSError, match="more than 1 MB"):
        bounded.read_bytes(path)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a." * 33 + "a = 1", "nested too deeply"),
        ("x = {" + "a." * 40 + "a = 1}", "nested too deeply"),
        ("[" + "a." * 20 + "a]\nx = " + "[" * 20 + "]" * 20, "nested too deeply"),
        ("[cv]\nx = 9223372036854775808", "f:2: cv.x: the integer has more than 64 bits"),
        ("x = " + "1" * 5000, "thousands of digits"),
    ],
)
def test_toml_that_is_too_deep_or_too_large(text: str, says: str) -> None:
    with pytest.raises(OneLineError, match=says):
        parsed(text, "f", OneLineError)


def test_a_long_value_is_cut_in_the_error() -> None:
    assert len(str(OneLineError("a" * 100_000))) < 3000


def test_a_mission_item_beyond_32_bits_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "m.waypoints"
    rows = [f"{seq}\t0\t3\t16\t0\t0\t0\t0\t{place}\t8\t9\t1" for seq, place in enumerate(("47", "1e308"))]
    path.write_text("\n".join(["QGC WPL 110", *rows]))
    status, _, err = run(capsys, "mission", "check", path, "--autopilot", "ardupilot")
    assert (status, err.count("\n")) == (2, 1)
    assert "line 3: x must be at most 3.40282e+38, not '1e308'" in err
