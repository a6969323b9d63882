"""TIMESYNC answers: only to the sender of the request, and at a limited rate.

PX4 forwards a TIMESYNC without target fields to every link, and sends ten requests a second itself.
"""

from __future__ import annotations

import struct

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.mavlink.codec import MavlinkMessage

RATE_HZ = 1.0
BURST = 4
MAX_ASKERS = 16
"""No autopilot has so many links. If there are more askers, the least recent one is forgotten."""

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


class TokenBuckets:
    """A token bucket for each asker: `BURST` answers at once, `RATE_HZ` on average."""

    def __init__(self) -> None:
        self._tokens: dict[tuple[int, int], tuple[float, float]] = {}

    def take(self, t: float, asker: tuple[int, int]) -> bool:
        """Take a token. True: `asker` gets an answer at time `t`."""
        left, at = self._tokens.pop(asker, (float(BURST), t))
        left = min(float(BURST), left + (t - at) * RATE_HZ)
        granted = left >= 1.0
        if len(self._tokens) >= MAX_ASKERS:
            del self._tokens[next(iter(self._tokens))]
        self._tokens[asker] = (left - 1.0 if granted else left, t)
        return granted
