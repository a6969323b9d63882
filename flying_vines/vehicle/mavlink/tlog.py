"""Recorded MAVLink streams (.tlog): each frame follows its time, in microseconds as 8 bytes, big-endian."""

from __future__ import annotations

import os
import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Self

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.files.bounded import RECORDING_BYTES, read_bytes
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.mavlink.frames import MARKERS, frame_at

MAX_SKIPPED_BYTES = 4_000_000
"""A file with more bytes outside of frames is no recording: to search it takes hours."""
_MARKER = re.compile(b"[" + re.escape(bytes(MARKERS)) + b"]")
_TIME = struct.Struct(">Q")
_EARLIEST_US = 946_684_800_000_000  # the year 2000, before MAVLink existed
_LATEST_US = 4_102_444_800_000_000


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
        data, at, found = self._data, 0, False
        while at < len(data):
            frame = self._frame_at(at)
            if frame is None:
                next_at = self._next_marker(at + 1)
                self.skipped_bytes += next_at - at
                at = next_at
                if self.skipped_bytes > MAX_SKIPPED_BYTES:
                    raise TlogError(
                        f"{self._path}: {self.skipped_bytes} bytes of it are no frames: is it a .tlog?"
                    )
                continue
            (time_us,) = _TIME.unpack_from(data, at)
            found = True
            yield time_us / 1e6, frame
            at += _TIME.size + len(frame)
        if not found:
            raise TlogError(f"{self._path}: no MAVLink frame in the file: is it a .tlog?")

    def _next_marker(self, at: int) -> int:
        """The next place where a record could start; the end of the data if there is none."""
        found = _MARKER.search(self._data, at + _TIME.size)
        return found.start() - _TIME.size if found else len(self._data)

    def _frame_at(self, at: int) -> bytes | None:
        """The frame of the record that starts at `at`; None if no record starts there."""
        data, begin = self._data, at + _TIME.size
        if begin >= len(data) or data[begin] not in MARKERS:
            return None
        if not _EARLIEST_US < _TIME.unpack_from(data, at)[0] < _LATEST_US:
            return None
        frame = frame_at(data, begin)
        if frame is None:
            return None
        follows = begin + len(frame.raw) + _TIME.size
        if follows < len(data) and data[follows] not in MARKERS and not self._checks(frame.raw):
            return None
        return frame.raw

    @staticmethod
    def _checks(frame: bytes) -> bool:
        parser = mavlink.MAVLink(None)
        parser.robust_parsing = True
        message: MavlinkMessage = parser.parse_char(frame)
        return message is not None and message.get_msgId() >= 0
