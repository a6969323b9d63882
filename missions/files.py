"""Reads the items of a mission from a .plan or .waypoints file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from flying_vines.vehicle.mission.item import AutopilotKind, MissionItem
from missions.home import Home, home_of
from missions.mission import MissionError
from missions.plan_file import PlanFileError, read_plan
from missions.waypoints import WaypointsError, read_waypoints

SUFFIXES = (".plan", ".waypoints", ".txt", ".mission")
"""`.mission` is QGroundControl's of 2015, which nobody reads; its error says what to do."""


@dataclass(frozen=True, slots=True)
class Items:
    """Items as they are sent; on ArduPilot item 0 is home."""

    items: tuple[MissionItem, ...]
    kind: AutopilotKind
    home: Home


def load_items(path: Path, kind: AutopilotKind | None = None) -> Items:
    """The mission in a .plan or .waypoints file, for `kind`; default: the autopilot that the file names.

    Raises `MissionError` if the file cannot be read, has no items, or names no autopilot.
    """
    try:
        if path.suffix.casefold() == ".plan":
            plan = read_plan(path, kind)
            return Items(plan.items, _known(plan.kind, path), plan.home)
        items = tuple(read_waypoints(path))
        kind = _known(kind, path)
    except (PlanFileError, WaypointsError) as error:
        raise MissionError(str(error)) from None
    if not items:
        raise MissionError(f"{path}: it contains no items")
    return Items(items, kind, home_of(items) or Home(0.0, 0.0, 0.0))


def _known(kind: AutopilotKind | None, path: Path) -> AutopilotKind:
    if kind is None:
        raise MissionError(f"{path}: names no autopilot: give --autopilot ardupilot or px4")
    return kind
