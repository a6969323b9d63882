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
