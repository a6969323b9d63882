"""Home of a mission: ArduPilot stores it as item 0, and PX4 does not store it."""

from __future__ import annotations

import math
from collections.abc import Sequence

from flying_vines.vehicle.autopilots import AUTOPILOTS
from flying_vines.vehicle.mission.item import GLOBAL_FRAMES, TAKEOFF, WAYPOINT, MissionItem, has_place
from flying_vines.vehicle.mission.reference_vehicle import Home
from flying_vines.vehicle.mission.storage import AutopilotKind


def is_home(item: MissionItem) -> bool:
    """True for home as ground stations write it: a waypoint with an altitude above sea level."""
    return item.command == WAYPOINT and item.frame in GLOBAL_FRAMES


def home_fits(items: Sequence[MissionItem], kind: AutopilotKind) -> bool:
    """False if ArduPilot would skip a first item that is not home, or if PX4 would fly to a home item."""
    if AUTOPILOTS[kind].begins_with_home:
        return is_home(items[0])
    return not (is_home(items[0]) and len(items) > 1 and items[1].command == TAKEOFF)


def home_of(items: Sequence[MissionItem]) -> Home | None:
    """Home if it is item 0; otherwise the first place, with an unknown altitude (0). None without a place."""
    for item in items:
        latitude, longitude, z = item.params[4:]
        if has_place(item.command, item.frame) and (latitude, longitude) != (0.0, 0.0) and on_earth(item):
            above_sea = item.seq == 0 and is_home(item) and math.isfinite(z)
            return Home(latitude, longitude, z if above_sea else 0.0)
    return None


def on_earth(item: MissionItem) -> bool:
    """True if x and y are a valid latitude and longitude."""
    latitude, longitude = item.params[4:6]
    return abs(latitude) <= 90.0 and abs(longitude) <= 180.0
