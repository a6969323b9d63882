"""Statistics of a link: traffic, losses, round trip and clock."""

from __future__ import annotations

import math
from typing import NamedTuple

from firmware_link.host import HostSession
from firmware_link.protocol import Codec


class LinkStatistics(NamedTuple):
    """Counts since the link object was made, and the present rates and clock values; None if unknown."""

    good_frames: int
    bad_frames: int
    """Frames with a wrong CRC, or bytes that are not a frame."""
    lost_frames: int
    """Frames that are missing between received sequence numbers."""
    unknown_messages: int
    telemetry_gaps: int
    """Telemetry frames that are missing between received device times, or have implausible contents."""
    reconnects: int
    received_bytes: int
    sent_bytes: int
    dropped_bytes: int
    """Bytes that were not sent, because the port was down or too slow."""
    received_bytes_per_s: int
    """In the last whole second."""
    sent_bytes_per_s: int
    """In the last whole second. The port may have dropped some of them."""
    round_trip_s: float | None
    clock_offset_s: float | None
    """Device clock minus host clock."""
    clock_drift_ppm: float | None


class Traffic:
    """Counts the traffic of one link. Times are seconds of one clock."""

    def __init__(self) -> None:
        self._openings = 0
        self._received = _Flow()
        self._written = _Flow()

    def opened(self) -> None:
        self._openings += 1

    def received(self, t: float, data: bytes) -> None:
        self._received.add(t, len(data))

    def written(self, t: float, data: bytes) -> None:
        """Data was passed to the port, which may still drop it."""
        self._written.add(t, len(data))

    def statistics(self, t: float, codec: Codec, session: HostSession, dropped_bytes: int) -> LinkStatistics:
        return LinkStatistics(
            good_frames=codec.good_frames,
            bad_frames=codec.bad_frames,
            lost_frames=codec.lost_frames,
            unknown_messages=codec.unknown_messages,
            telemetry_gaps=session.telemetry_gaps,
            reconnects=max(0, self._openings - 1),
            received_bytes=self._received.total,
            sent_bytes=self._written.total - dropped_bytes,
            dropped_bytes=dropped_bytes,
            received_bytes_per_s=self._received.per_s(t),
            sent_bytes_per_s=self._written.per_s(t),
            round_trip_s=session.round_trip_s,
            clock_offset_s=session.clock_offset_s,
            clock_drift_ppm=session.clock_drift_ppm,
        )


class _Flow:
    """A total count, and the count in the last whole second."""

    def __init__(self) -> None:
        self.total = 0
        self._second = 0
        self._of_this_second = 0
        self._of_last_second = 0

    def add(self, t: float, count: int) -> None:
        self._advance(t)
        self.total += count
        self._of_this_second += count

    def per_s(self, t: float) -> int:
        self._advance(t)
        return self._of_last_second

    def _advance(self, t: float) -> None:
        second = math.floor(t)
        if second != self._second:
            self._of_last_second = self._of_this_second if second == self._second + 1 else 0
            self._of_this_second = 0
            self._second = second
