"""One item of a mission, as in MAVLink's MISSION_ITEM_INT and in QGC WPL 110 files."""

from __future__ import annotations

from dataclasses import dataclass

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
