"""One item of a mission, as in MAVLink's MISSION_ITEM_INT and in QGC WPL 110 files."""

from __future__ import annotations

from dataclasses import dataclass


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


NAV_SCRIPT_TIME = 42702
_LAST_NAV = 95


def is_nav(command: int) -> bool:
    """True if the vehicle flies (or waits) for it before the mission continues."""
    return command <= _LAST_NAV or command == NAV_SCRIPT_TIME


_NAV_WITHOUT_PLACE = {83, 92, 93, NAV_SCRIPT_TIME}
_DO_WITH_PLACE = {179, 189, 195, 201}
_PLAIN_FRAMES = {1, 2}


def has_place(command: int, frame: int) -> bool:
    """True if x and y are a latitude and a longitude (1e-7 degrees in MISSION_ITEM_INT)."""
    placed = command not in _NAV_WITHOUT_PLACE if is_nav(command) else command in _DO_WITH_PLACE
    return placed and frame not in _PLAIN_FRAMES
