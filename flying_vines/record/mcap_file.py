"""The MCAP file of a flight. It is readable while it grows, and if it is cut off or damaged.

Messages are in compressed chunks, each with a checksum. Schemas and channels are in the first chunk, and
again in the summary at the end. So damage at one place leaves one copy intact.
"""

from __future__ import annotations

import json
import mmap
import struct
import zlib
from collections.abc import Iterator, Sequence
from io import BytesIO
from typing import BinaryIO

import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Statistics
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import CompressionType, Writer

from flying_vines.record.topics import Topic

MAGIC = b"\x89MCAP0\r\n"
MAX_CHUNK_BYTES = 1 << 24
"""Size after decompression. The recorder ends a chunk at 1 MB."""
MAX_GROWTH = 100
"""All chunks together may unpack to this multiple of the file. The recorder's grow less than 20 times."""
FREE_BYTES = 4 * MAX_CHUNK_BYTES
"""A small file may unpack to this much in any case."""
MAX_LOG_BYTES = 1_000_000_000
"""The recorder begins a new file after five hours: 300 MB."""
MAX_SUMMARY_BYTES = 1 << 26
"""The recorder's summary of its 36,000 chunks takes 20 MB. A larger one is not read."""
_SEQUENCES = 1 << 32
_CHUNK_HEAD = struct.Struct("<BQQQQI")
_ZSTD = struct.pack("<I4s", 4, b"zstd")
_LENGTH = struct.Struct("<Q")
_FOOTER = struct.Struct("<BQQQI")
_CRC_BYTES = 4


class McapFile:
    """Writes to a binary file. Each `flush` ends a chunk. Times are unix time in ns; they need not rise."""

    def __init__(self, file: BinaryIO, topics: Sequence[Topic], library: str) -> None:
        self.chunks = 0
        """Number of chunks. Each chunk takes memory until the summary is written."""
        self._sequence = 0
        self._writer = Writer(file, compression=CompressionType.ZSTD)
        self._writer.start(library=library)
        for topic in topics:
            text = json.dumps(topic.schema, separators=(",", ":")).encode()
            schema = self._writer.register_schema(topic.schema_name, SchemaEncoding.JSONSchema, text)
            self._writer.register_channel(topic.name, MessageEncoding.JSON, schema)

    def add(self, channel: int, time_ns: int, data: bytes) -> None:
        """`channel` is the topic's number, counted from 1."""
        self._writer.add_message(channel, time_ns, data, time_ns, self._sequence % _SEQUENCES)
        self._sequence += 1

    def flush(self) -> None:
        self._writer.flush()  # type: ignore[no-untyped-call]
        self.chunks += 1

    def finish(self) -> None:
        """Write the summary. After that nothing can be added."""
        self._writer.finish()  # type: ignore[no-untyped-call]


class TooLargeError(Exception):
    """The file unpacks to more than any log; the text is the reason."""


def read_chunks(data: mmap.mmap) -> Iterator[list[McapRecord]]:
    """The records of each zstd chunk with a correct checksum, at any place in the file.

    The recorder writes no other chunks. The sizes in the headers of chunk and zstd are not believed: the
    bytes that are really read and written count. Raises `TooLargeError`.
    """
    if len(data) > MAX_LOG_BYTES:
        raise TooLargeError(f"has more than {MAX_LOG_BYTES // 1_000_000} MB: no flight log does")
    left_bytes = FREE_BYTES + MAX_GROWTH * len(data)
    end = 0
    while (found := data.find(_ZSTD, end)) >= 0:
        end = found + len(_ZSTD)
        at = found - _CHUNK_HEAD.size
        begin = end + _LENGTH.size
        if at < 0 or begin > len(data):
            continue
        opcode, _, _, _, _, checksum = _CHUNK_HEAD.unpack_from(data, at)
        (length,) = _LENGTH.unpack_from(data, end)
        if opcode != Opcode.CHUNK or length > min(len(data) - begin, MAX_CHUNK_BYTES):
            continue
        compressed = data[begin : begin + length]
        left_bytes -= length
        try:
            unpacked = _unpacked(compressed)
        except zstandard.ZstdError:
            continue
        left_bytes -= len(unpacked)
        if len(unpacked) > MAX_CHUNK_BYTES or left_bytes < 0:
            raise TooLargeError(
                f"unpacks to more than {MAX_CHUNK_BYTES >> 20} MB in one part, or to more than {MAX_GROWTH} "
                "times its size: no flight log does"
            )
        if checksum not in (0, zlib.crc32(unpacked)):
            continue
        try:
            records = breakup_chunk(Chunk("", unpacked, 0, 0, 0, len(unpacked)))
        except (McapError, ValueError, struct.error):
            continue
        end = begin + length
        yield records


def _unpacked(compressed: bytes) -> bytes:
    """At most one byte more than `MAX_CHUNK_BYTES`."""
    decompressor = zstandard.ZstdDecompressor(max_window_size=MAX_CHUNK_BYTES)
    with decompressor.stream_reader(compressed) as stream:
        return stream.read(MAX_CHUNK_BYTES + 1)


def read_summary(data: mmap.mmap) -> list[Channel | Statistics]:
    """The channels and counts of the summary; empty if it is missing or damaged."""
    footer_at = len(data) - len(MAGIC) - _FOOTER.size
    if footer_at < 0 or data[-len(MAGIC) :] != MAGIC:
        return []
    opcode, _, begin, _, checksum = _FOOTER.unpack_from(data, footer_at)
    if opcode != Opcode.FOOTER or begin >= footer_at or footer_at - begin > MAX_SUMMARY_BYTES:
        return []
    summary = data[begin:]
    if zlib.crc32(summary[: footer_at - begin + _FOOTER.size - _CRC_BYTES]) != checksum:
        return []
    # A chunk in the summary must not be unpacked.
    reader = StreamReader(BytesIO(summary), skip_magic=True, emit_chunks=True)
    try:
        return [record for record in reader.records if isinstance(record, Channel | Statistics)]
    except (McapError, ValueError, struct.error):
        return []
