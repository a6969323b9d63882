"""MAVLink frames in a stream of bytes: where each begins and ends, and whether its checksum fits.

Message types, checksums and packing are pymavlink's. Its parser is not used, for three reasons: it accepts a
stream's signing timestamp before it has checked the signature, so that one forged frame locks the real sender
out; it loses good frames next to a damaged one; and it is too slow for a small board.

After a false or damaged frame of a known message the search goes on at its second byte. So good frames within
the length that it claims are found. The checksum of a message that the dialect lacks cannot be checked: it
counts as a frame if another frame begins where it ends.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

_MARKER_1, _MARKER_2 = mavlink.PROTOCOL_MARKER_V1, mavlink.PROTOCOL_MARKER_V2
_MARKERS = bytes((_MARKER_1, _MARKER_2))
_ANY_MARKER = re.compile(b"[%b]" % _MARKERS)
_HEADER_1 = struct.Struct("<BBBBBB").unpack_from
_HEADER_2 = struct.Struct("<BBBBBBBHB").unpack_from
_HEADER_SIZE_1, _HEADER_SIZE_2 = 6, 10
_CHECKSUM_SIZE = 2
SIGNATURE_SIZE: int = mavlink.MAVLINK_SIGNATURE_BLOCK_LEN
_TAIL_SIZE = _CHECKSUM_SIZE + SIGNATURE_SIZE
_AUTOPILOT: int = mavlink.MAV_COMP_ID_AUTOPILOT1
_SIGNED: int = mavlink.MAVLINK_IFLAG_SIGNED
LONGEST_FRAME = _HEADER_SIZE_2 + 255 + _TAIL_SIZE

_CRC_EXTRA = {number: bytes((kind.crc_extra,)) for number, kind in mavlink.mavlink_map.items()}
"""What enters the checksum of each message that the dialect knows."""

_checksum: Callable[[bytes], int] = getattr(mavlink, "mcrf4xx", None) or (
    lambda data: int(mavlink.x25crc(data).crc)
)
"""The compiled function if it is installed: pymavlink's class around it is three times slower."""


class Frame(NamedTuple):
    """One frame. If the dialect does not know it (`known` is false), its checksum was not checked."""

    raw: bytes
    payload: bytes
    known: bool
    message_id: int
    system: int
    component: int
    sequence: int
    checksum: int
    flags: int
    """Incompatibility flags; 0 in version 1 of the protocol."""
    other_flags: int

    @property
    def signed(self) -> bool:
        return self.flags == _SIGNED


class Frames:
    """Cuts a stream of bytes into frames, however it is chunked."""

    def __init__(self) -> None:
        self.bad_frames = 0
        """Frames with a wrong checksum, and stretches of other bytes."""
        self._rest = b""
        self._bad_until = -1

    def take(self, data: bytes) -> list[Frame]:
        """The frames that `data` completes, in order."""
        frames: list[Frame] = []
        data = self._rest + data
        at, end = 0, len(data)
        while at < end:
            if data[at] not in _MARKERS:
                at = self._skip_noise(data, at)
                continue
            frame = _frame_at(data, at)
            if frame is None:
                break
            stop = at + len(frame.raw)
            if frame.known:
                good = _fits(frame)
            elif stop == end:
                break  # the next byte decides; the result must not depend on how the stream is cut
            else:
                good = data[stop] in _MARKERS
            if good:
                frames.append(frame)
                at = stop
            else:
                self._count_bad(at, stop)
                at += 1
        self._rest = data[at:]
        self._bad_until = max(-1, self._bad_until - at)
        return frames

    def _count_bad(self, at: int, stop: int) -> None:
        """Count a bad stretch once, even with several false headers in it."""
        if at >= self._bad_until:
            self.bad_frames += 1
            self._bad_until = stop

    def _skip_noise(self, data: bytes, at: int) -> int:
        """Where the next frame may begin."""
        if at > self._bad_until:
            self.bad_frames += 1
        found = _ANY_MARKER.search(data, at)
        until = found.start() if found else len(data)
        self._bad_until = max(self._bad_until, until)
        return until


def from_autopilot(data: bytes) -> bool:
    """Whether these bytes hold a whole frame that says it comes from an autopilot."""
    return any(frame.known and frame.component == _AUTOPILOT for frame in Frames().take(data))


def _frame_at(data: bytes, at: int) -> Frame | None:
    """The frame whose header is at `at`; None until all of its bytes have arrived."""
    end = len(data)
    must = may = 0
    if data[at] == _MARKER_2:
        begin = at + _HEADER_SIZE_2
        if begin > end:
            return None
        _, length, must, may, sequence, system, component, low, high = _HEADER_2(data, at)
        message_id = low | high << 16
    else:
        begin = at + _HEADER_SIZE_1
        if begin > end:
            return None
        _, length, sequence, system, component, message_id = _HEADER_1(data, at)
    behind = begin + length
    stop = behind + (_TAIL_SIZE if must & _SIGNED else _CHECKSUM_SIZE)
    if stop > end:
        return None
    checksum = data[behind] | data[behind + 1] << 8
    known = must <= _SIGNED and message_id in _CRC_EXTRA
    return Frame(
        data[at:stop], data[begin:behind], known, message_id, system, component, sequence, checksum, must, may
    )


def _fits(frame: Frame) -> bool:
    """Whether the checksum is the one of such a message."""
    covered = frame.raw[1 : -_TAIL_SIZE if frame.flags else -_CHECKSUM_SIZE]
    return _checksum(covered + _CRC_EXTRA[frame.message_id]) == frame.checksum
