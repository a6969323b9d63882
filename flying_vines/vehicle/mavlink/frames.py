"""Finds MAVLink frames in a stream of bytes, and checks their checksums.

Message types, checksums and packing are pymavlink's. Its parser is not used, for three reasons. It accepts a
stream's signing timestamp before it has checked the signature, so one forged frame locks out the real sender.
It loses good frames next to a damaged one. It is too slow for a small board.

After a damaged frame of a known message the search continues at its second byte. So good frames within its
claimed length are found. The checksum of a message that the dialect lacks cannot be checked. Such a message
counts as a frame if another frame begins at its end.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

_MARKER_1, _MARKER_2 = mavlink.PROTOCOL_MARKER_V1, mavlink.PROTOCOL_MARKER_V2
MARKERS = bytes((_MARKER_1, _MARKER_2))
_ANY_MARKER = re.compile(b"[%b]" % MARKERS)
_HEADER_1 = struct.Struct("<BBBBBB").unpack_from
_HEADER_2 = struct.Struct("<BBBBBBBHB").unpack_from
_HEADER_SIZE_1, _HEADER_SIZE_2 = 6, 10
_CHECKSUM_SIZE = 2
SIGNATURE_SIZE: int = mavlink.MAVLINK_SIGNATURE_BLOCK_LEN
_TAIL_SIZE = _CHECKSUM_SIZE + SIGNATURE_SIZE
_AUTOPILOT: int = mavlink.MAV_COMP_ID_AUTOPILOT1
_SIGNED: int = mavlink.MAVLINK_IFLAG_SIGNED

_CRC_EXTRA = {number: bytes((kind.crc_extra,)) for number, kind in mavlink.mavlink_map.items()}
"""CRC_EXTRA of each message in the dialect: an additional byte of its checksum."""

_checksum: Callable[[bytes], int] = getattr(mavlink, "mcrf4xx", None) or (
    lambda data: int(mavlink.x25crc(data).crc)
)
"""The compiled function, if installed. pymavlink's class around it is three times slower."""


class Frame(NamedTuple):
    """One frame. If the dialect lacks its message (`known` is false), its checksum was not checked."""

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
    """Compatibility flags; 0 in version 1 of the protocol."""

    @property
    def signed(self) -> bool:
        return self.flags == _SIGNED


class Frames:
    """Splits a stream of bytes into frames. How the stream is cut into chunks does not change the result."""

    def __init__(self) -> None:
        self.bad_frames = 0
        """The number of frames with a wrong checksum and of byte sequences that are not frames."""
        self._rest = b""
        self._bad_until = -1

    def take(self, data: bytes) -> list[Frame]:
        """The frames that `data` completes, in order."""
        frames: list[Frame] = []
        data = self._rest + data
        at, end = 0, len(data)
        while at < end:
            if data[at] not in MARKERS:
                at = self._skip_noise(data, at)
                continue
            frame = frame_at(data, at)
            if frame is None:
                break
            stop = at + len(frame.raw)
            if frame.known:
                good = fits(frame)
            elif stop == end:
                break  # wait for the next byte: the result must not depend on how the stream is split
            else:
                good = data[stop] in MARKERS
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
        """Count a bad byte sequence once, even with several false headers in it."""
        if at >= self._bad_until:
            self.bad_frames += 1
            self._bad_until = stop

    def _skip_noise(self, data: bytes, at: int) -> int:
        """The index at which the next frame may begin."""
        if at > self._bad_until:
            self.bad_frames += 1
        found = _ANY_MARKER.search(data, at)
        until = found.start() if found else len(data)
        self._bad_until = max(self._bad_until, until)
        return until


def from_autopilot(data: bytes) -> bool:
    """True if these bytes contain a complete frame with the component id of an autopilot."""
    return any(frame.known and frame.component == _AUTOPILOT for frame in Frames().take(data))


def frame_in(raw: bytes) -> Frame:
    """The frame in `raw`, which was whole and right when it was received or sent. It is not checked again."""
    frame = frame_at(raw, 0)
    assert frame is not None
    return frame


def frame_at(data: bytes, at: int) -> Frame | None:
    """The frame that begins with the marker at `at`; None until all of its bytes have arrived."""
    end = len(data)
    incompat = compat = 0
    if data[at] == _MARKER_2:
        begin = at + _HEADER_SIZE_2
        if begin > end:
            return None
        _, length, incompat, compat, sequence, system, component, low, high = _HEADER_2(data, at)
        message_id = low | high << 16
    else:
        begin = at + _HEADER_SIZE_1
        if begin > end:
            return None
        _, length, sequence, system, component, message_id = _HEADER_1(data, at)
    behind = begin + length
    stop = behind + (_TAIL_SIZE if incompat & _SIGNED else _CHECKSUM_SIZE)
    if stop > end:
        return None
    checksum = data[behind] | data[behind + 1] << 8
    known = incompat <= _SIGNED and message_id in _CRC_EXTRA
    return Frame(
        data[at:stop],
        data[begin:behind],
        known,
        message_id,
        system,
        component,
        sequence,
        checksum,
        incompat,
        compat,
    )


def fits(frame: Frame) -> bool:
    """True if the checksum of a `known` frame is right."""
    covered = frame.raw[1 : -_TAIL_SIZE if frame.flags else -_CHECKSUM_SIZE]
    return _checksum(covered + _CRC_EXTRA[frame.message_id]) == frame.checksum
