"""Home of a mission, and the speeds of the vehicle that planning assumes and that the stand-ins fly.

ArduPilot stores home as item 0, and PX4 does not store it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from flying_vines.vehicle.autopilots import AUTOPILOTS
from flying_vines.vehicle.mission.item import (
    GLOBAL_FRAMES,
    TAKEOFF,
    WAYPOINT,
    AutopilotKind,
    MissionItem,
    has_place,
)

CRUISE_M_S = 5.0
VERTICAL_M_S = 2.5
TOUCHDOWN_M_S = 0.5
FLARE_HEIGHT_M = 2.0

_METRES_PER_DEGREE = 111_318.84


@dataclass(frozen=True, slots=True)
class Home:
    """The place where the vehicle was switched on: the origin of its local coordinates."""

    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float

    def local_m(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
        """North and east of home, on a plane."""
        shrink = math.cos(math.radians(self.latitude_deg))
        return (
            (latitude_deg - self.latitude_deg) * _METRES_PER_DEGREE,
            (longitude_deg - self.longitude_deg) * _METRES_PER_DEGREE * shrink,
        )

    def global_deg(self, north_m: float, east_m: float) -> tuple[float, float]:
        """Latitude and longitude of a point of the plane."""
        shrink = math.cos(math.radians(self.latitude_deg))
        return (
            self.latitude_deg + north_m / _METRES_PER_DEGREE,
            self.longitude_deg + east_m / (_METRES_PER_DEGREE * shrink),
        )


SIMULATOR_HOME: Mapping[AutopilotKind, Home] = MappingProxyType(
    {
        "ardupilot": Home(-35.363262, 149.165237, 584.09),
        "px4": Home(47.3977431, 8.5455944, 489.443),
    }
)
"""Home of each autopilot's own simulator (SITL)."""


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
