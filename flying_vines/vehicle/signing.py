"""MAVLink 2 message signing: which frames are believed, and the clock that ours are signed with.

Sans-IO: the edge tells the time, and keeps `timestamp` over restarts (`signing_key.TimestampFile`). The key
comes from a file of this machine and from nowhere else: SETUP_SIGNING is never acted on.

What is sent can be recorded and sent again, so the timestamps of each stream (link, system, component) must
rise. What MAVLink leaves open: of a stream that was not heard before, as after our own restart, frames up to
a minute old are believed, each once.
"""

from __future__ import annotations

import hashlib
import hmac
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.frames import SIGNATURE_SIZE, Frame

KEY_SIZE = 32
UNITS_PER_S = 100_000
"""A timestamp counts tens of microseconds."""

UNIX_TIME_OF_ZERO_S = 1_420_070_400
"""Timestamps count from 1 January 2015."""

NEW_STREAM_MAY_LAG = 60 * UNITS_PER_S
MOST_STREAMS = 64
"""More components than any vehicle has; only who has the key can make an entry."""

_DIGEST_SIZE = 6
_STAMP_SIZE = SIGNATURE_SIZE - _DIGEST_SIZE
"""One byte of link, six of timestamp."""

_RADIO = mavlink.MAV_COMP_ID_TELEMETRY_RADIO
_RADIO_MESSAGES = {mavlink.MAVLINK_MSG_ID_RADIO_STATUS, mavlink.MAVLINK_MSG_ID_RADIO}
"""What a telemetry radio says of itself: it has no key, and nothing that it says moves anything."""


@dataclass(slots=True)
class Refused:
    """Frames that were not believed, by reason."""

    unsigned: int = 0
    forged: int = 0
    replayed: int = 0
    """Their timestamp was used before, or is of a new stream and too old."""

    @property
    def total(self) -> int:
        return self.unsigned + self.forged + self.replayed

    def __str__(self) -> str:
        return f"{self.unsigned} unsigned, {self.forged} forged, {self.replayed} replayed"


class Signing:
    """Signs and checks with one key on one link. `timestamp` is the last one used, and never falls."""

    def __init__(self, key: bytes, link_id: int = 0, timestamp: int = 0) -> None:
        if len(key) != KEY_SIZE:
            raise ValueError(f"a signing key has {KEY_SIZE} bytes, not {len(key)}")
        self.key = key
        self.link_id = link_id
        self.timestamp = timestamp
        self.refused = Refused()
        self._streams: dict[tuple[int, int, int], int] = {}

    def advance(self, unix_time_s: float) -> None:
        """Tell the time; a clock that was set back or never set holds nothing up."""
        self.timestamp = max(self.timestamp, int((unix_time_s - UNIX_TIME_OF_ZERO_S) * UNITS_PER_S))

    def next_timestamp(self) -> int:
        """The timestamp of the frame that is sent now: no two frames share one."""
        self.timestamp += 1
        return self.timestamp

    def admits(self, frame: Frame) -> bool:
        """Whether a frame is to be believed; a `True` uses its timestamp up."""
        if not frame.signed:
            if frame.message_id in _RADIO_MESSAGES and frame.component == _RADIO:
                return True
            self.refused.unsigned += 1
            return False
        signed, signature = frame.raw[:-_DIGEST_SIZE], frame.raw[-_DIGEST_SIZE:]
        expected = hashlib.sha256(self.key + signed).digest()[:_DIGEST_SIZE]
        if not hmac.compare_digest(expected, signature):
            self.refused.forged += 1
            return False
        link_id, timestamp = signed[-_STAMP_SIZE], int.from_bytes(signed[1 - _STAMP_SIZE :], "little")
        if not self._is_new((link_id, frame.system, frame.component), timestamp):
            self.refused.replayed += 1
            return False
        self.timestamp = max(self.timestamp, timestamp)
        return True

    def _is_new(self, stream: tuple[int, int, int], timestamp: int) -> bool:
        last = self._streams.get(stream)
        if last is None:
            oldest = self.timestamp - NEW_STREAM_MAY_LAG
            if timestamp < oldest:
                return False
            if len(self._streams) >= MOST_STREAMS:
                # Of those forgotten here every copy is as good as refused: too old for a new stream.
                self._streams = {known: at for known, at in self._streams.items() if at >= oldest}
            if len(self._streams) >= MOST_STREAMS:
                return False
        elif timestamp <= last:
            return False
        self._streams[stream] = timestamp
        return True
