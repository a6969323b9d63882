"""What a link knows of itself: how much goes over it, what is lost on it, how far away the device is."""

from __future__ import annotations

import math
from typing import NamedTuple

from firmware_link.host import HostSession
from firmware_link.protocol import Codec


class LinkStatistics(NamedTuple):
    """Counts since the link was made; the rest as of now, None where it is not known."""

    good_frames: int
    bad_frames: int
    """With a wrong CRC, or bytes that are no frame."""
    lost_frames: int
    """By their sequence numbers."""
    unknown_messages: int
    telemetry_gaps: int
    """Telemetry that should have come by the device's own clock, and did not."""
    reconnects: int
    received_bytes: int
    sent_bytes: int
    dropped_bytes: int
    """To be sent, but the port was down or did not take them in time."""
    received_bytes_per_s: int
    """In the last whole second; the port may have dropped some of those to be sent."""
    sent_bytes_per_s: int
    round_trip_s: float | None
    clock_offset_s: float | None
    """Device clock minus host clock."""
    clock_drift_ppm: float | None


class Traffic:
    """Counts what goes over one link. Times are seconds of one clock."""

    def __init__(self) -> None:
        self._openings = 0
        self._received = _Flow()
        self._written = _Flow()

    def opened(self) -> None:
        self._openings += 1

    def received(self, t: float, data: bytes) -> None:
        self._received.add(t, len(data))

    def written(self, t: float, data: bytes) -> None:
        """Handed to the port, which may still drop it."""
        self._written.add(t, len(data))

    def statistics(self, t: float, codec: Codec, session: HostSession, dropped_bytes: int) -> LinkStatistics:
        """As of `t`."""
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
    """A count, and how much of it came in the last whole second."""

    def __init__(self) -> None:
        self.total = 0
        self._second = 0
        self._of_this_second = 0
        self._of_last_second = 0

    def add(self, t: float, count: int) -> None:
        self._turn(t)
        self.total += count
        self._of_this_second += count

    def per_s(self, t: float) -> int:
        self._turn(t)
        return self._of_last_second

    def _turn(self, t: float) -> None:
        second = math.floor(t)
        if second != self._second:
            self._of_last_second = self._of_this_second if second == self._second + 1 else 0
            self._of_this_second = 0
            self._second = second
