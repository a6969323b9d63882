"""Common parts of all autopilots' mission storages. `autopilots` has the differences."""

from __future__ import annotations

import math
import struct
from typing import Literal

from flying_vines.vehicle.mission.item import MissionItem

AutopilotKind = Literal["ardupilot", "px4"]

ACCEPTED, ERROR, UNSUPPORTED_FRAME, UNSUPPORTED, NO_SPACE = 0, 1, 2, 3, 4
INVALID_PARAM1, INVALID_SEQUENCE, DENIED, CANCELLED = 6, 13, 14, 15
"""MAV_MISSION_RESULT."""

CAPACITY = 700
MISSION_FRAME = 2

Params = tuple[float, float, float, float, float, float, float]


class MissionRefused(ValueError):
    """The autopilot refuses this item; `result` is the MAV_MISSION_RESULT."""

    def __init__(self, item: MissionItem, result: int) -> None:
        super().__init__(f"item {item.seq} (command {item.command}) refused with MAV_MISSION_RESULT {result}")
        self.result = result


def f32(value: float) -> float:
    """The number as a 32-bit float, as in MAVLink and in ArduPilot's storage; infinite if it is too large."""
    try:
        return float(struct.unpack("<f", struct.pack("<f", value))[0])
    except OverflowError:
        return math.copysign(math.inf, value)
