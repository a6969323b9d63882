"""Reads flight logs, over whatever was done to them.

A chunk is found by its look and believed by its checksum: a file that was cut off, or of which parts are
damaged, is read as far as it is whole, and it says how much of it is not.
"""

from __future__ import annotations

import mmap
import re
import struct
import zlib
from collections.abc import Collection, Iterator
from datetime import datetime
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel

from flying_vines.record.folders import MCAP
from flying_vines.record.mcap_file import COMPRESSION, MAGIC

_CHUNK_HEAD = struct.Struct("<BQQQQI")
_LOOK = re.compile(re.escape(struct.pack("<I", len(COMPRESSION)) + COMPRESSION.encode()))
_LENGTH = struct.Struct("<Q")
_RECORD = struct.Struct("<BQ")
_FOOTER = struct.Struct("<BQQQI")
_MESSAGE = struct.Struct("<HIQQ")
MOST_CHUNK_BYTES = 256 * 1024 * 1024
"""Unpacked; what claims more is damaged."""
_decode = msgspec.json.Decoder(dict[str, Any]).decode


class LogError(Exception):
    """A log that cannot be read; the text is one line that says which, and why."""


class Entry(NamedTuple):
    """One message of the log."""

    topic: str
    unix_ns: int
    data: bytes
    """JSON."""

    @property
    def fields(self) -> dict[str, Any]:
        return _decode(self.data)


class FlightLog:
    """A flight's log: `path` is its folder, or the file itself.

    What `lost` and `cut_off` say holds once `entries` was gone through.
    """

    def __init__(self, path: Path) -> None:
        self.path = path / MCAP if path.is_dir() else path
        self.lost = 0
        """Messages that should be between those that are there."""
        self.cut_off = False
        """The log was not brought to its end."""
        self._last_ns = 0

    @property
    def folder(self) -> Path:
        return self.path.parent

    @property
    def damage(self) -> str:
        """A sentence for people; empty for a whole log."""
        said = []
        if self.lost:
            said.append(f"{self.lost} messages of it are damaged and left out")
        if self.cut_off:
            last = datetime.fromtimestamp(self._last_ns / 1e9).strftime("%H:%M:%S")
            said.append(f"it was not brought to its end: it is read up to {last}")
        return f"{self.path.name}: {'; '.join(said)}" if said else ""

    def entries(self, topics: Collection[str] | None = None) -> Iterator[Entry]:
        """All, or those of some topics, in the order in which they happened.

        Raises `LogError` when there is nothing to read.
        """
        try:
            with self.path.open("rb") as file:
                if not file.read(1):
                    raise LogError(f"{self.path}: is empty")
                with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
                    yield from self._entries(data, topics)
        except OSError as error:
            raise LogError(f"{self.path}: cannot be read: {error.strerror}") from None

    def _entries(self, data: mmap.mmap, topics: Collection[str] | None) -> Iterator[Entry]:
        self.lost, self.cut_off, self._last_ns = 0, data[-len(MAGIC) :] != MAGIC, 0
        names: dict[int, str] = {}
        expected = 0
        unnamed: list[bytes] = []
        for chunk in _chunks(data):
            if not names:
                names = _names(chunk)
                if not names:
                    unnamed.append(chunk)  # the chunk that names the topics is damaged; another will do so
                    continue
                ready = [*unnamed, chunk]
            else:
                ready = [chunk]
            for part in ready:
                for channel, sequence, unix_ns, message in _messages(part):
                    self.lost += (sequence - expected) & 0xFFFFFFFF
                    expected = (sequence + 1) & 0xFFFFFFFF
                    self._last_ns = unix_ns
                    name = names.get(channel, "")
                    if name and (topics is None or name in topics):
                        yield Entry(name, unix_ns, message)
        if not names:
            raise LogError(f"{self.path}: is no flight log, or nothing of it can be read")
        if not self.cut_off:
            self.lost += max(0, _promised(data) - expected)


def _promised(data: mmap.mmap) -> int:
    """How many messages the summary says there are; 0 where it cannot be read."""
    footer_at = len(data) - len(MAGIC) - _FOOTER.size
    if footer_at < 0:
        return 0
    opcode, _, summary_at, _, _ = _FOOTER.unpack_from(data, footer_at)
    if opcode != Opcode.FOOTER or summary_at > footer_at:
        return 0
    summary = data[summary_at:footer_at]
    for opcode, begin, end in _records(summary):
        if opcode == Opcode.STATISTICS and end <= len(summary):
            count: int = _LENGTH.unpack_from(summary, begin)[0]
            return count if count <= len(data) else 0
    return 0


def _chunks(data: mmap.mmap) -> Iterator[bytes]:
    """The unpacked chunks whose checksum is right."""
    unpack = zstandard.ZstdDecompressor().decompress
    for found in _LOOK.finditer(data):
        at, behind = found.start() - _CHUNK_HEAD.size, found.end() + _LENGTH.size
        if at < 0 or behind > len(data):
            continue
        opcode, length, _, _, size, checksum = _CHUNK_HEAD.unpack_from(data, at)
        (packed,) = _LENGTH.unpack_from(data, found.end())
        if opcode != Opcode.CHUNK or length != behind + packed - at - _RECORD.size or size > MOST_CHUNK_BYTES:
            continue
        try:
            chunk = unpack(data[behind : behind + packed], max_output_size=size)
        except zstandard.ZstdError:
            continue
        if zlib.crc32(chunk) == checksum:
            yield chunk


def _records(chunk: bytes) -> Iterator[tuple[int, int, int]]:
    """What kind, from where, to where."""
    at = 0
    while at + _RECORD.size <= len(chunk):
        opcode, length = _RECORD.unpack_from(chunk, at)
        at += _RECORD.size
        yield opcode, at, at + length
        at += length


def _names(chunk: bytes) -> dict[int, str]:
    channels = [
        Channel.read(ReadDataStream(BytesIO(chunk[begin:end])))
        for opcode, begin, end in _records(chunk)
        if opcode == Opcode.CHANNEL
    ]
    return {channel.id: channel.topic for channel in channels}


def _messages(chunk: bytes) -> Iterator[tuple[int, int, int, bytes]]:
    """Channel, running number, time, JSON."""
    for opcode, begin, end in _records(chunk):
        if opcode == Opcode.MESSAGE:
            channel, sequence, unix_ns, _ = _MESSAGE.unpack_from(chunk, begin)
            yield channel, sequence, unix_ns, chunk[begin + _MESSAGE.size : end]
