"""Predicts when and where a mission's items run, and for how long, with straight flight paths.

The rules for non-navigation items (vine items too) were observed on real autopilots. ArduPilot runs these
items when the previous navigation item is done, and on the ground if they come before the first navigation
item. After the last navigation item ArduPilot runs only one more item, and after the landing none. PX4 runs
all items one by one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from flying_vines.vehicle.autopilots import AUTOPILOTS
from flying_vines.vehicle.mission.item import (
    DELAY,
    FOR_EVER,
    GLOBAL_FRAMES,
    JUMP,
    LAND,
    LOITER_TIME,
    LOITER_TURNS,
    LOITER_UNLIMITED,
    NAV_SCRIPT_TIME,
    RETURN,
    SPEED,
    SPLINE,
    TAKEOFF,
    VTOL_LAND,
    VTOL_TAKEOFF,
    WAYPOINT,
    AutopilotKind,
    Jumps,
    MissionItem,
    has_place,
)
from missions.home import CRUISE_M_S, FLARE_HEIGHT_M, TOUCHDOWN_M_S, VERTICAL_M_S, Home

MAX_STEPS = 1000
MAX_LENGTH_S = 6 * 3600.0
"""Limits of the prediction: the rest of a longer mission is not checked."""

_TURN_S = 10.0
_HOLD_IN_PARAM1 = {WAYPOINT, SPLINE, LOITER_TIME, DELAY}
ENDS = (LAND, RETURN, VTOL_LAND)
_NOTHING_AFTER = (*ENDS, LOITER_UNLIMITED)


@dataclass(frozen=True, slots=True)
class TimelineStep:
    """One flown or executed item."""

    item: MissionItem
    flown: bool
    t_s: float
    """Start of the item, counted from the start of the take-off."""
    takes_s: float
    distance_m: float
    height_m: float
    """Above home, at the end of the item."""
    waypoint: int
    """Number of waypoints begun so far, including this item if it is a waypoint."""

    @property
    def ends_s(self) -> float:
        return self.t_s + self.takes_s


@dataclass(frozen=True, slots=True)
class Timeline:
    """The items that run, in order, and those that never run."""

    steps: tuple[TimelineStep, ...]
    never: tuple[MissionItem, ...]
    """Items that this autopilot never runs."""
    cut: bool
    """True if the mission exceeds the limits; the steps are only its beginning."""
    home: Home

    @property
    def length_s(self) -> float:
        return max((step.ends_s for step in self.steps), default=0.0)

    @property
    def end(self) -> MissionItem | None:
        """The item that ends the mission (landing, return, endless loiter); None if the items run out."""
        last = self.steps[-1].item if self.steps else None
        return last if last is not None and last.command in _NOTHING_AFTER else None


def timeline(items: Sequence[MissionItem], kind: AutopilotKind, home: Home) -> Timeline:
    """Predict the flight of the items."""
    return _Flight(items, kind, home).fly()


class _Flight:
    def __init__(self, items: Sequence[MissionItem], kind: AutopilotKind, home: Home) -> None:
        self._items = items
        self._kind: AutopilotKind = kind
        self._autopilot = AUTOPILOTS[kind]
        self._home = home
        self._steps: list[TimelineStep] = []
        self._t_s = self._north_m = self._east_m = self._height_m = 0.0
        self._speed_m_s = CRUISE_M_S
        self._waypoint = 0
        self._turns = 0

    def fly(self) -> Timeline:
        seq = first = int(self._autopilot.begins_with_home)
        jumps = Jumps()
        trailing = 0
        ended = False
        while seq < len(self._items) and not ended and not self._cut:
            item = self._items[seq]
            if item.command == JUMP:
                # Fly an endless loop only once.
                seq = seq + 1 if item.params[1] == FOR_EVER else jumps.take(item)
                self._turns += 1
                continue
            if self._autopilot.waits_for(item):
                self._fly(item)
                trailing = 0
                ended = item.command in _NOTHING_AFTER
            else:
                self._run(item)
                trailing += 1
            seq += 1
        if self._cut:
            del self._steps[-1:]
        elif self._kind == "ardupilot" and trailing > 1:
            del self._steps[1 - trailing :]
        ran = {step.item.seq for step in self._steps}
        never = tuple(item for item in self._items[first:] if item.seq not in ran and item.command != JUMP)
        return Timeline(tuple(self._steps), () if self._cut else never, self._cut, self._home)

    @property
    def _cut(self) -> bool:
        return self._t_s > MAX_LENGTH_S or len(self._steps) + self._turns > MAX_STEPS

    def _run(self, item: MissionItem) -> None:
        if item.command == SPEED and item.params[1] > 0.0:
            self._speed_m_s = item.params[1]
        self._add(item, flown=False, takes_s=0.0, distance_m=0.0)

    def _fly(self, item: MissionItem) -> None:
        north_m, east_m, height_m = self._goal(item)
        distance_m = math.hypot(north_m - self._north_m, east_m - self._east_m)
        takes_s = max(distance_m / self._speed_m_s, abs(height_m - self._height_m) / VERTICAL_M_S)
        if item.command in ENDS:
            takes_s += _descent_s(height_m)
            height_m = 0.0
        self._north_m, self._east_m, self._height_m = north_m, east_m, height_m
        if item.command in (WAYPOINT, SPLINE):
            self._waypoint += 1
        self._add(item, flown=True, takes_s=takes_s + _stays_s(item), distance_m=distance_m)

    def _goal(self, item: MissionItem) -> tuple[float, float, float]:
        """North, east and height of the item's goal; missing values stay as they are."""
        x, y, z = item.params[4:]
        if item.command == RETURN:
            return 0.0, 0.0, self._height_m
        placed = has_place(item.command, item.frame)
        north_m, east_m = self._north_m, self._east_m
        moves = item.command not in (TAKEOFF, VTOL_TAKEOFF)
        if placed and moves and math.isfinite(x) and math.isfinite(y) and (x, y) != (0.0, 0.0):
            north_m, east_m = self._home.local_m(x, y)
        if not placed or not math.isfinite(z) or z == 0.0 or item.command in ENDS:
            return north_m, east_m, self._height_m
        height_m = z - self._home.altitude_amsl_m if item.frame in GLOBAL_FRAMES else z
        return north_m, east_m, height_m

    def _add(self, item: MissionItem, flown: bool, takes_s: float, distance_m: float) -> None:
        self._steps.append(
            TimelineStep(item, flown, self._t_s, takes_s, distance_m, self._height_m, self._waypoint)
        )
        self._t_s += takes_s


def _stays_s(item: MissionItem) -> float:
    first, second = item.params[:2]
    seconds = 0.0
    if item.command in _HOLD_IN_PARAM1:
        seconds = first
    elif item.command == LOITER_TURNS:
        seconds = first * _TURN_S
    elif item.command == NAV_SCRIPT_TIME:
        seconds = second
    return seconds if math.isfinite(seconds) and seconds > 0.0 else 0.0


def _descent_s(height_m: float) -> float:
    slow_m = min(max(0.0, height_m), FLARE_HEIGHT_M)
    return max(0.0, height_m - slow_m) / VERTICAL_M_S + slow_m / TOUCHDOWN_M_S
