"""Reads a mission as a person writes it: a short TOML file of places and vine actions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from flying_vines.files.toml_text import converted, one_line, read_text
from flying_vines.vehicle.mission.item import AutopilotKind
from missions.home import SIMULATOR_HOME, Home

Height = Annotated[float, Meta(gt=0, le=1000)]
Latitude = Annotated[float, Meta(ge=-90, le=90)]
Longitude = Annotated[float, Meta(ge=-180, le=180)]
At = tuple[Latitude, Longitude]


class MissionError(ValueError):
    """A mission cannot be read, built or written. The text has one line for each problem."""

    def __init__(self, *problems: str) -> None:
        super().__init__("\n".join(one_line(problem) for problem in problems))


class _Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    pass


class PlannedHome(_Table, frozen=True):
    """The place of the take-off; the altitude is above mean sea level."""

    at: At
    altitude_m: Annotated[float, Meta(ge=-500, le=9000)]


class VineAction(_Table, frozen=True):
    """An action of the vine at a place, and how long the vehicle waits for it."""

    profile: str | None = None
    bend_deg: float | None = None
    hold_s: Annotated[float, Meta(ge=0, le=3600)] | None = None
    """Wait from the action's start. Default: until the vine is at rest."""

    def __post_init__(self) -> None:
        if (self.profile is None) == (self.bend_deg is None):
            raise ValueError("the vine needs either profile or bend_deg")


class Takeoff(_Table, frozen=True):
    """Height above home, and vine actions before the first waypoint."""

    altitude_m: Height
    vine: tuple[VineAction, ...] = ()


class Waypoint(_Table, frozen=True):
    """A place as latitude and longitude, or as metres from home. The height is above home."""

    at: At | None = None
    north_m: float | None = None
    east_m: float | None = None
    altitude_m: Height | None = None
    """Default: the height of the previous place."""
    stay_s: Annotated[int, Meta(ge=0, le=3600)] = 0
    """Wait before the first vine action. Whole seconds, because ArduPilot stores no fractions."""
    vine: tuple[VineAction, ...] = ()

    def __post_init__(self) -> None:
        offset = self.north_m is not None or self.east_m is not None
        if (self.at is None) != offset:
            raise ValueError("a waypoint needs either at = [latitude, longitude], or north_m and east_m")


class Mission(_Table, frozen=True):
    """The whole file."""

    takeoff: Takeoff
    waypoints: Annotated[tuple[Waypoint, ...], Meta(min_length=1, max_length=500)]
    name: Annotated[str, Meta(max_length=100)] = ""
    autopilot: AutopilotKind | None = None
    home: PlannedHome | Literal["simulator"] | None = None
    speed_m_s: Annotated[float, Meta(gt=0, le=30)] | None = None
    """Default: the autopilot's own."""
    end: Literal["land", "return"] = "land"


def load(path: Path) -> tuple[Mission, str]:
    """The mission in a file, and its text, for line numbers in errors. Raises `MissionError`."""
    text = read_text(path, MissionError)
    return parse(text, str(path)), text


def parse(text: str, source: str) -> Mission:
    """Check a mission's text; errors name it as `source`."""
    mission: Mission = converted(text, source, Mission, MissionError)
    return mission


def planned_home(mission: Mission, kind: AutopilotKind, source: str) -> Home:
    """The home of the mission on this kind of autopilot. Raises `MissionError` if it is missing."""
    if mission.home is None:
        raise MissionError(
            f"{source}: home: is missing: home = {{ at = [latitude, longitude], altitude_m = ... }}, or "
            'home = "simulator" for the home of the autopilot\'s own simulator'
        )
    if mission.home == "simulator":
        return SIMULATOR_HOME[kind]
    return Home(*mission.home.at, mission.home.altitude_m)
