"""A trigger: the vehicle rolls or pitches far, as in a gust. The configuration says what the vine does."""

import math

from flying_vines.vehicle.mavlink.codec import MavlinkMessage


class Gust:
    messages = ("ATTITUDE",)

    def __init__(self, angle_deg: float = 25.0) -> None:
        self._angle_rad = math.radians(angle_deg)

    def holds(self, t: float, message: MavlinkMessage) -> bool:
        return max(abs(message.roll), abs(message.pitch)) > self._angle_rad
