"""An MCAP file that is written while it grows, and survives being cut off anywhere.

Messages go into chunks, each compressed, each with a checksum. What a reader must know to understand them
(schemas and channels) is in the first two chunks and again in one every minute: no single damaged place makes
the rest unreadable. The summary that lets a viewer jump about comes at the end; of a file without one, all
is still read from beginning to end.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections import Counter
from collections.abc import Sequence
from typing import BinaryIO

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    MessageIndex,
    Statistics,
    SummaryOffset,
)
from mcap.records import Schema as SchemaRecord
from mcap.well_known import MessageEncoding, SchemaEncoding

from flying_vines.record.topics import Topic

MAGIC = b"\x89MCAP0\r\n"
COMPRESSION = "zstd"
LEVEL = 3
DEFINED_EVERY_NS = 60_000_000_000
_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_HEAD = 2 + 4 + 8 + 8
_SEQUENCES = 1 << 32


class McapFile:
    """Writes to a binary file; nothing reaches it before `flush`. Times are unix time in ns."""

    def __init__(self, file: BinaryIO, topics: Sequence[Topic], library: str) -> None:
        self.index_bytes = 0
        """Of memory, for the summary."""
        self._file = file
        self._topics = len(topics)
        self._schemas, self._channels = _definitions(topics)
        self._compressor = zstandard.ZstdCompressor(level=LEVEL)
        self._chunk = bytearray()
        self._places: dict[int, list[tuple[int, int]]] = {}
        """Time and place in the chunk of each channel's messages."""
        self._chunk_index = bytearray()
        self._chunks = 0
        self._sequence = 0
        self._counts: Counter[int] = Counter()
        self._first_ns, self._last_ns = 0, 0
        self._chunk_first_ns, self._chunk_last_ns = 0, 0
        self._defined_ns = 0
        builder = RecordBuilder()
        Header(profile="", library=library).write(builder)
        head = MAGIC + _bytes(builder)
        self._file.write(head)
        self._at = len(head)

    def add(self, channel: int, time_ns: int, data: bytes) -> None:
        """Times need not be in order."""
        if not self._places:
            self._begin_chunk(time_ns)
        self._places.setdefault(channel, []).append((time_ns, len(self._chunk)))
        sequence = self._sequence % _SEQUENCES
        size = _MESSAGE_HEAD + len(data)
        self._chunk += _MESSAGE.pack(Opcode.MESSAGE, size, channel, sequence, time_ns, time_ns)
        self._chunk += data
        self._sequence += 1
        self._chunk_first_ns = min(self._chunk_first_ns, time_ns)
        self._chunk_last_ns = max(self._chunk_last_ns, time_ns)

    def flush(self) -> None:
        """End the chunk, and hand the file all that there is."""
        if self._places:
            self._write_chunk()
        self._file.flush()

    def finish(self) -> None:
        """Write the summary; after that nothing can be added."""
        self.flush()
        end = RecordBuilder()
        DataEnd(data_section_crc=0).write(end)
        summary, offsets = RecordBuilder(), RecordBuilder()
        starts_at = self._at + end.count
        statistics = RecordBuilder()
        self._statistics().write(statistics)
        for opcode, group in (
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, _bytes(statistics)),
            (Opcode.CHUNK_INDEX, bytes(self._chunk_index)),
        ):
            if group:
                SummaryOffset(opcode, starts_at + summary.count, len(group)).write(offsets)
                summary.write(group)
        offsets_at = starts_at + summary.count
        told = _bytes(summary) + _bytes(offsets)
        head = struct.pack("<BQQQ", Opcode.FOOTER, 8 + 8 + 4, starts_at, offsets_at)
        footer = RecordBuilder()
        Footer(starts_at, offsets_at, zlib.crc32(head, zlib.crc32(told))).write(footer)
        self._file.write(_bytes(end) + told + _bytes(footer) + MAGIC)
        self._file.flush()

    def _begin_chunk(self, time_ns: int) -> None:
        self._chunk_first_ns = self._chunk_last_ns = time_ns
        if self._chunks < 2 or time_ns - self._defined_ns >= DEFINED_EVERY_NS:
            self._chunk += self._schemas + self._channels
            self._defined_ns = time_ns

    def _write_chunk(self) -> None:
        packed = self._compressor.compress(self._chunk)
        builder = RecordBuilder()
        Chunk(
            compression=COMPRESSION,
            data=packed,
            message_start_time=self._chunk_first_ns,
            message_end_time=self._chunk_last_ns,
            uncompressed_crc=zlib.crc32(self._chunk),
            uncompressed_size=len(self._chunk),
        ).write(builder)
        length = builder.count
        places = {}
        for channel, records in self._places.items():
            places[channel] = self._at + builder.count
            MessageIndex(channel, records).write(builder)
            self._counts[channel] += len(records)
        index = RecordBuilder()
        ChunkIndex(
            chunk_length=length,
            chunk_start_offset=self._at,
            compression=COMPRESSION,
            compressed_size=len(packed),
            message_end_time=self._chunk_last_ns,
            message_index_length=builder.count - length,
            message_index_offsets=places,
            message_start_time=self._chunk_first_ns,
            uncompressed_size=len(self._chunk),
        ).write(index)
        self._chunk_index += _bytes(index)
        self.index_bytes = len(self._chunk_index)
        written = _bytes(builder)
        self._file.write(written)
        self._at += len(written)
        self._first_ns = min(self._first_ns, self._chunk_first_ns) if self._chunks else self._chunk_first_ns
        self._last_ns = max(self._last_ns, self._chunk_last_ns)
        self._chunks += 1
        self._chunk.clear()
        self._places.clear()

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=0,
            channel_count=self._topics,
            channel_message_counts=dict(self._counts),
            chunk_count=self._chunks,
            message_count=self._counts.total(),
            message_end_time=self._last_ns,
            message_start_time=self._first_ns,
            metadata_count=0,
            schema_count=self._topics,
        )


def _bytes(builder: RecordBuilder) -> bytes:
    """All that was written into it."""
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


def _definitions(topics: Sequence[Topic]) -> tuple[bytes, bytes]:
    """The records of all schemas and of all channels, which have the same numbers."""
    schemas, channels = RecordBuilder(), RecordBuilder()
    for number, topic in enumerate(topics, start=1):
        text = json.dumps(topic.schema, separators=(",", ":")).encode()
        SchemaRecord(number, data=text, encoding=SchemaEncoding.JSONSchema, name=topic.schema_name).write(
            schemas
        )
        Channel(number, topic.name, MessageEncoding.JSON, metadata={}, schema_id=number).write(channels)
    return _bytes(schemas), _bytes(channels)
