"""One item of a mission, as MAVLink's MISSION_ITEM_INT carries it and QGC WPL 110 files store it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class MissionItem:
    """A mission item.

    `params` holds param1…param4 and then x, y, z; for items with a position x and y are degrees
    (latitude, longitude), z is metres. NaN means "not given", as in MAVLink.
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
    """Whether the vehicle flies (or waits) for it before the mission goes on."""
    return command <= _LAST_NAV or command == NAV_SCRIPT_TIME


_NAV_WITHOUT_PLACE = {83, 92, 93, NAV_SCRIPT_TIME}
_DO_WITH_PLACE = {179, 189, 195, 201}
_PLAIN_FRAMES = {1, 2}


def has_place(command: int, frame: int) -> bool:
    """Whether x and y are a latitude and a longitude (1e-7 degrees in MISSION_ITEM_INT), or plain numbers."""
    placed = command not in _NAV_WITHOUT_PLACE if is_nav(command) else command in _DO_WITH_PLACE
    return placed and frame not in _PLAIN_FRAMES
