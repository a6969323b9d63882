"""TIMESYNC: we answer the autopilot's requests at a limited rate, and send requests of our own.

Messages have target fields, because PX4 forwards those without them to every link. PX4 sends ten requests a
second.
"""

from __future__ import annotations

import math
import struct

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.mavlink.codec import MavlinkMessage

RATE_HZ = 1.0
BURST = 4
"""Answers at once; on average `RATE_HZ`."""
PERIOD_S = 1.0
"""Of our own requests."""
MAX_OPEN = 32
"""Requests whose answer may still come."""

_TARGET = struct.Struct("<qqBB")
_TARGET_AT = 16
"""Offset of the target fields in the payload. A frame without them is shorter, or has zeros there."""


class Timesync(mavlink.MAVLink_timesync_message):  # type: ignore[misc]
    """TIMESYNC with its MAVLink 2 target fields, which the dialect lacks."""

    def __init__(self, tc1: int, ts1: int, target_system: int, target_component: int) -> None:
        super().__init__(tc1, ts1)
        self.target_system, self.target_component = target_system, target_component

    def pack(self, mav: MavlinkMessage, force_mavlink1: bool = False) -> bytes:
        payload = _TARGET.pack(self.tc1, self.ts1, self.target_system, self.target_component)
        frame: bytes = self._pack(mav, self.crc_extra, payload, force_mavlink1=force_mavlink1)
        return frame


def target_of(message: MavlinkMessage) -> tuple[int, int]:
    """Target system and component of a received TIMESYNC; zeros if it is a broadcast."""
    system, component = (message.get_payload() or b"")[_TARGET_AT:].ljust(2, b"\0")[:2]
    return system, component


class TimesyncRequests:
    """Our requests. An answer proves that the messages after it are newer than the request."""

    def __init__(self) -> None:
        self._due_at = -math.inf
        self._sent_at: dict[int, float] = {}

    def due(self, t: float, system_id: int) -> list[MavlinkMessage]:
        if t < self._due_at:
            return []
        self._due_at = t + PERIOD_S
        stamp_ns = int(t * 1e9)
        if len(self._sent_at) >= MAX_OPEN:
            del self._sent_at[next(iter(self._sent_at))]
        self._sent_at[stamp_ns] = t
        return [Timesync(0, stamp_ns, system_id, mavlink.MAV_COMP_ID_AUTOPILOT1)]

    def answered(self, message: MavlinkMessage) -> float | None:
        """When we sent the request that this TIMESYNC of the autopilot answers; None if it answers none."""
        return self._sent_at.pop(message.ts1, None) if message.tc1 else None
