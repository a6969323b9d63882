"""An item of a mission, as in MAVLink's MISSION_ITEM_INT and in QGC WPL 110 files: its form, its
execution, what all autopilots' storages have in common, and DO_JUMP.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

WAYPOINT, LOITER_UNLIMITED, LOITER_TURNS, LOITER_TIME, RETURN, LAND, TAKEOFF = 16, 17, 18, 19, 20, 21, 22
SPLINE, VTOL_TAKEOFF, VTOL_LAND, GUIDED_ENABLE, DELAY = 82, 84, 85, 92, 93
CONDITION_DELAY, CONDITION_DISTANCE, CONDITION_YAW = 112, 114, 115
SPEED, NAV_SCRIPT_TIME = 178, 42702
"""Commands (MAV_CMD)."""

GLOBAL_FRAME, ABOVE_HOME_FRAME = 0, 3
GLOBAL_FRAMES = (GLOBAL_FRAME, 5)
"""z is an altitude above sea level."""
MAX_NUMBER = 3.4028234663852886e38
"""The largest number that MAVLink can carry: 32 bits."""


@dataclass(frozen=True, slots=True)
class MissionItem:
    """A mission item.

    `params` is param1…param4, x, y, z. For items with a position, x and y are latitude and longitude in
    degrees, z is in metres. NaN means "not given", as in MAVLink.
    """

    seq: int
    command: int
    params: tuple[float, float, float, float, float, float, float]
    frame: int = 0
    current: bool = False
    autocontinue: bool = True


_LAST_NAV = 95


def is_nav(command: int) -> bool:
    """True if the mission continues only after the vehicle has flown or waited for this command."""
    return command <= _LAST_NAV or command == NAV_SCRIPT_TIME


_NAV_WITHOUT_PLACE = {83, GUIDED_ENABLE, DELAY, NAV_SCRIPT_TIME}
_DO_WITH_PLACE = {179, 189, 195, 201}
_PLAIN_FRAMES = {1, 2}


def has_place(command: int, frame: int) -> bool:
    """True if x and y are a latitude and a longitude (1e-7 degrees in MISSION_ITEM_INT)."""
    placed = command not in _NAV_WITHOUT_PLACE if is_nav(command) else command in _DO_WITH_PLACE
    return placed and frame not in _PLAIN_FRAMES


JUMP = 177
FOR_EVER = -1


class Jumps:
    """Counts the repetitions of each DO_JUMP."""

    def __init__(self) -> None:
        self._taken: dict[int, int] = {}

    def take(self, item: MissionItem) -> int:
        """The seq of the next item: the jump's target, or the item after it if no repetition is left."""
        target, times = item.params[0], item.params[1]
        taken = self._taken.get(item.seq, 0)
        if not (math.isfinite(target) and target >= 0) or (times != FOR_EVER and not taken < times):
            return item.seq + 1
        self._taken[item.seq] = taken + 1
        return int(target)


@dataclass(frozen=True, slots=True)
class Execution:
    """A mission item that ran. `seq`, `item` and `params` are None if they are uncertain."""

    command: int
    seq: int | None
    item: MissionItem | None
    params: tuple[float, ...] | None
    age_s: float = 0.0
    """The minimum time since it ran."""
    changed: bool = False
    """The autopilot sent other params than those in the cache."""


def same_numbers(a: Sequence[float], b: Sequence[float]) -> bool:
    """True if the numbers are equal within the precision of 32-bit floats and text files."""
    return all(
        math.isclose(x, y, rel_tol=1e-5, abs_tol=1e-6) or (math.isnan(x) and math.isnan(y))
        for x, y in zip(a, b, strict=True)
    )


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
