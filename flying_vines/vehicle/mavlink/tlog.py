"""Recorded MAVLink streams (.tlog): each frame follows its time, in microseconds as 8 bytes, big-endian."""

from __future__ import annotations

import os
import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Self

from flying_vines.files.bounded import RECORDING_BYTES, read_bytes
from flying_vines.vehicle.mavlink.frames import MARKERS, fits, frame_at

MAX_SKIPPED_BYTES = 4_000_000
"""A file with more bytes outside of frames is no recording: to search it takes hours."""
_MARKER = re.compile(b"[" + re.escape(bytes(MARKERS)) + b"]")
_MARKERS = tuple(bytes((marker,)) for marker in MARKERS)
_TIME = struct.Struct(">Q")
_EARLIEST_US = 946_684_800_000_000
"""The year 2000, before MAVLink existed. A computer without a clock begins in 1970."""
_LATEST_US = 4_102_444_800_000_000
_LOOKED_AT_BYTES = 100_000
_STREAM = "no MAVLink frame in the file has a time: it is a raw stream; record a .tlog, as MAVProxy does"
_NO_TLOG = {
    b"\xa3\x95\x80\x80": "an ArduPilot DataFlash log (.bin): give the ground station's .tlog",
    b"FMT, 128": "an ArduPilot DataFlash log as text: give the ground station's .tlog",
    b"ULog": "a PX4 log (.ulg): give the ground station's .tlog",
    b"\x89MCAP": "an MCAP file: name it .mcap",
    b"PK\x03\x04": "a zip file: unpack it first",
    b"\x1f\x8b": "a gzip file: unpack it first",
    b"\xd4\xc3\xb2\xa1": "a capture of network packets (.pcap)",
    b"\x0a\x0d\x0d\x0a": "a capture of network packets (.pcapng)",
    b"QGC WPL": "a mission (.waypoints)",
    b'{\n    "': "a .plan of QGroundControl",
}
"""Files that people take for a .tlog, by their first bytes."""


class TlogError(Exception):
    """The file is not a recording; the text is the reason."""


class TlogWriter:
    """Writes frames. They stay in memory until `sync`. Leaving the context closes the file."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb")
        self._waiting: list[bytes] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._file.close()

    def write(self, time_us: int, frame: bytes) -> None:
        """Add a frame of this unix time."""
        self._waiting.append(_TIME.pack(time_us) + frame)

    def sync(self) -> None:
        """Write all frames to the disk (fsync)."""
        self._file.write(b"".join(self._waiting))
        self._waiting.clear()
        self._file.flush()
        os.fsync(self._file.fileno())


class TlogReader:
    """Reads the frames of a .tlog in order, and skips damaged parts.

    `skipped_bytes` counts the bytes that are not part of a frame, including a truncated end.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._data = read_bytes(path, RECORDING_BYTES)
        except FileNotFoundError:
            raise TlogError(f"{path}: no such file") from None
        except OSError as error:
            raise TlogError(f"{path}: cannot be read: {error.strerror}") from None
        self._path = path
        self.skipped_bytes = 0

    def frames(self) -> Iterator[tuple[float, bytes]]:
        """(unix time in s, raw frame). Raises `TlogError` if there is no frame."""
        if self._is_stream():
            raise TlogError(f"{self._path}: {_STREAM}")
        data, at, found = self._data, 0, False
        while at < len(data):
            frame = self._frame_at(at)
            if frame is None:
                next_at = self._next_marker(at + 1)
                self.skipped_bytes += next_at - at
                at = next_at
                if self.skipped_bytes > MAX_SKIPPED_BYTES:
                    raise TlogError(
                        f"{self._path}: {self.skipped_bytes} bytes are no frames: {self._guess()}"
                    )
                continue
            (time_us,) = _TIME.unpack_from(data, at)
            found = True
            yield time_us / 1e6, frame
            at += _TIME.size + len(frame)
        if not found:
            raise TlogError(f"{self._path}: no MAVLink frame in the file: {self._guess()}")

    def _guess(self) -> str:
        """What the file is instead of a .tlog."""
        if not self._data.strip(b"\0"):
            return (
                "it is all zeros: its disk was full, or its computer lost power"
                if self._data
                else "it is empty"
            )
        return next(
            (f"it is {what}" for head, what in _NO_TLOG.items() if self._data.startswith(head)),
            "is it a .tlog?",
        )

    def _is_stream(self) -> bool:
        """True if frames follow one another without a time between them."""
        data = self._data[:_LOOKED_AT_BYTES]
        at = directly = with_time = 0
        while (marker := _MARKER.search(data, at)) is not None:
            frame = frame_at(data, marker.start())
            if frame is None or not frame.known or not fits(frame):
                at = marker.start() + 1
                continue
            at = marker.start() + len(frame.raw)
            directly += data[at : at + 1] in _MARKERS
            with_time += data[at + _TIME.size : at + _TIME.size + 1] in _MARKERS
        return directly > with_time

    def _next_marker(self, at: int) -> int:
        """The next place where a record could start; the end of the data if there is none."""
        found = _MARKER.search(self._data, at + _TIME.size)
        return found.start() - _TIME.size if found else len(self._data)

    def _frame_at(self, at: int) -> bytes | None:
        """The frame of the record that starts at `at`; None if no record starts there."""
        data, begin = self._data, at + _TIME.size
        if begin >= len(data) or data[begin] not in MARKERS:
            return None
        (time_us,) = _TIME.unpack_from(data, at)
        if time_us >= _LATEST_US:
            return None
        frame = frame_at(data, begin)
        if frame is None:
            return None
        follows = begin + len(frame.raw) + _TIME.size
        is_doubtful = time_us < _EARLIEST_US or (follows < len(data) and data[follows] not in MARKERS)
        if is_doubtful and not (frame.known and fits(frame)):
            return None
        return frame.raw
