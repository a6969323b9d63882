"""The MCAP file of a flight. It is readable while it grows, and if it is cut off or damaged.

Messages are in compressed chunks, each with a checksum. Schemas and channels are in the first chunk, and
again in the summary at the end. So damage at one place leaves one copy intact.
"""

from __future__ import annotations

import json
import mmap
import re
import struct
import zlib
from collections.abc import Iterator, Sequence
from io import BytesIO
from typing import BinaryIO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk, McapRecord
from mcap.stream_reader import CRCValidationError, StreamReader, breakup_chunk
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import CompressionType, Writer

from flying_vines.record.topics import Topic

MAGIC = b"\x89MCAP0\r\n"
MAX_CHUNK_BYTES = 256 * 1024 * 1024
"""Size after decompression. A chunk that claims more is damaged."""
_SEQUENCES = 1 << 32
_LENGTH_OF_RECORD = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<BQQQQI")
_COMPRESSION = re.compile(re.escape(struct.pack("<I4s", 4, b"zstd")))
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


def read_chunks(data: mmap.mmap) -> Iterator[list[McapRecord]]:
    """The records of each chunk with a correct checksum, at any place in the file."""
    for found in _COMPRESSION.finditer(data):
        at = found.start() - _CHUNK_HEAD.size
        if at < 0:
            continue
        opcode, length, _, _, size, _ = _CHUNK_HEAD.unpack_from(data, at)
        begin = at + _LENGTH_OF_RECORD.size
        if opcode != Opcode.CHUNK or begin + length > len(data) or size > MAX_CHUNK_BYTES:
            continue
        try:
            chunk = Chunk.read(ReadDataStream(BytesIO(data[begin : begin + length])))
            records = breakup_chunk(chunk, validate_crc=True)
        except (McapError, CRCValidationError, zstandard.ZstdError):
            continue
        yield records


def read_summary(data: mmap.mmap) -> list[McapRecord]:
    """The records of the summary; empty if it is missing or damaged."""
    footer_at = len(data) - len(MAGIC) - _FOOTER.size
    if footer_at < 0 or data[-len(MAGIC) :] != MAGIC:
        return []
    opcode, _, begin, _, checksum = _FOOTER.unpack_from(data, footer_at)
    if opcode != Opcode.FOOTER or begin >= footer_at:
        return []
    if zlib.crc32(data[begin : footer_at + _FOOTER.size - _CRC_BYTES]) != checksum:
        return []
    return list(StreamReader(BytesIO(data[begin:]), skip_magic=True).records)
