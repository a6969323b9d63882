"""Builds the items of a mission for one kind of autopilot."""

from __future__ import annotations

import math
from dataclasses import replace

from flying_vines.config.config import Config
from flying_vines.core.motion_planner import MotionPlanner
from flying_vines.files.toml_text import Key, dotted, place
from flying_vines.vehicle.autopilots import AUTOPILOTS
from flying_vines.vehicle.mission.item import (
    ABOVE_HOME_FRAME,
    DELAY,
    GLOBAL_FRAME,
    LAND,
    MISSION_FRAME,
    RETURN,
    SPEED,
    TAKEOFF,
    WAYPOINT,
    AutopilotKind,
    MissionItem,
)
from flying_vines.vine.intent import BendTo, Intent, StartProfile
from missions.home import Home
from missions.item_for_intent import item_for_intent, suggestion
from missions.mission import Mission, MissionError, VineAction, Waypoint

BEND_LESS = "calibrate this angle, or bend less"
REST_S = 0.5
"""Time for the vine to come to rest after a motion. Default holds are multiples of it."""


def build(
    mission: Mission, config: Config, kind: AutopilotKind, home: Home, source: str, text: str = ""
) -> list[MissionItem]:
    """The items to send; on ArduPilot item 0 is home.

    Args:
        source: name of the mission's file in errors.
        text: the file's text, for line numbers in errors.

    Raises `MissionError` with one line for each action that the vine or this autopilot cannot do.
    """
    builder = _Builder(config, kind, source, text)
    with_home = AUTOPILOTS[kind].begins_with_home
    yaw = 0.0 if with_home else math.nan  # NaN: the vehicle chooses its yaw; ArduPilot refuses NaN
    latitude, longitude = home.latitude_deg, home.longitude_deg
    if with_home:
        builder.add(WAYPOINT, (0, 0, 0, 0, latitude, longitude, home.altitude_amsl_m), GLOBAL_FRAME)
    height = mission.takeoff.altitude_m
    builder.add(TAKEOFF, (0, 0, 0, yaw, latitude, longitude, height), ABOVE_HOME_FRAME)
    builder.act(mission.takeoff.vine, ("takeoff", "vine"))
    if mission.speed_m_s is not None:
        # Type 1: ground speed, m/s; -1: throttle unchanged.
        builder.add(SPEED, (1, mission.speed_m_s, -1, 0, 0, 0, 0), MISSION_FRAME)
    for index, waypoint in enumerate(mission.waypoints):
        latitude, longitude = _place(waypoint, home)
        height = height if waypoint.altitude_m is None else waypoint.altitude_m
        numbers = (float(waypoint.stay_s), 0.0, 0.0, yaw, latitude, longitude, height)
        builder.add(WAYPOINT, numbers, ABOVE_HOME_FRAME)
        builder.act(waypoint.vine, ("waypoints", index, "vine"))
    if mission.end == "land":
        builder.add(LAND, (0, 0, 0, yaw, latitude, longitude, 0), ABOVE_HOME_FRAME)
    else:
        builder.add(RETURN, (0, 0, 0, 0, 0, 0, 0), MISSION_FRAME)
    if builder.problems:
        raise MissionError(*builder.problems)
    return builder.items


def _place(waypoint: Waypoint, home: Home) -> tuple[float, float]:
    """Latitude and longitude; if computed from metres, rounded to 1e-7 degrees as in MISSION_ITEM_INT."""
    if waypoint.at is not None:
        return waypoint.at
    latitude, longitude = home.global_deg(waypoint.north_m or 0.0, waypoint.east_m or 0.0)
    return round(latitude, 7), round(longitude, 7)


class _Builder:
    """Appends items, and plans the vine's motions to know when it is at rest."""

    def __init__(self, config: Config, kind: AutopilotKind, source: str, text: str) -> None:
        self.items: list[MissionItem] = []
        self.problems: list[str] = []
        self._config = config
        self._kind: AutopilotKind = kind
        self._source = source
        self._text = text
        self._planner = MotionPlanner(config)
        self._pressure_kPa = self._bent_kPa = 0.0

    def add(
        self, command: int, params: tuple[float, float, float, float, float, float, float], frame: int
    ) -> None:
        p1, p2, p3, p4, x, y, z = map(float, params)
        seq = len(self.items)
        self.items.append(MissionItem(seq, command, (p1, p2, p3, p4, x, y, z), frame, current=seq == 0))

    def act(self, actions: tuple[VineAction, ...], key: Key) -> None:
        """Add the vine items of one place, each followed by a wait."""
        for index, action in enumerate(actions):
            intent: Intent = (
                StartProfile(action.profile) if action.profile is not None else BendTo(action.bend_deg or 0.0)
            )
            item = self._carrier(intent, (*key, index))
            if item is None:
                continue
            self.items.append(replace(item, seq=len(self.items)))
            motion = self._planner.plan(intent, self._pressure_kPa, self._bent_kPa)
            self._pressure_kPa, self._bent_kPa = motion.final_kPa, motion.bent_kPa
            rest_s = (math.ceil(motion.duration_s / REST_S) + 1) * REST_S
            hold_s = rest_s if action.hold_s is None else action.hold_s
            if hold_s > 0.0:
                self.add(DELAY, (hold_s, -1, -1, -1, 0, 0, 0), MISSION_FRAME)

    def _carrier(self, intent: Intent, key: Key) -> MissionItem | None:
        problem = self._planner.problem(intent)
        if problem:
            self._complain(key, f"{problem}; {BEND_LESS}" if isinstance(intent, BendTo) else problem)
            return None
        item = item_for_intent(intent, self._config, self._kind)
        if item is None:
            wanted = f"profile '{intent.name}'" if isinstance(intent, StartProfile) else str(intent)
            add = suggestion(intent, self._config, self._kind)
            name = AUTOPILOTS[self._kind].title
            self._complain(
                key,
                f"no rule gives an item for {wanted} on {name}; add to the configuration: {add}",
            )
        return item

    def _complain(self, key: Key, reason: str) -> None:
        self.problems.append(f"{place(self._text, self._source, key)}: {dotted(key)}: {reason}")
