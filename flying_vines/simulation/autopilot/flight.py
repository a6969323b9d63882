"""How the simulated copter flies: modes, motion as a point at constant speed, navigation commands."""

from __future__ import annotations

import math
from dataclasses import dataclass

from flying_vines.vehicle.mission.item import (
    CONDITION_DELAY,
    DELAY,
    GLOBAL_FRAMES,
    GUIDED_ENABLE,
    LAND,
    LOITER_TURNS,
    LOITER_UNLIMITED,
    NAV_SCRIPT_TIME,
    RETURN,
    TAKEOFF,
    VTOL_LAND,
    VTOL_TAKEOFF,
    AutopilotKind,
    MissionItem,
)
from missions.home import (
    CRUISE_M_S,
    FLARE_HEIGHT_M,
    TOUCHDOWN_M_S,
    VERTICAL_M_S,
    Home,
)

_SPOOL_UP_S = 2.0
_TURN_S = 10.0
_RETURN_HEIGHT_M = 15.0
_RETURN_HOLD_S = 5.0


@dataclass(frozen=True, slots=True)
class FlightMode:
    """A flight mode as HEARTBEAT shows it; `base` is base_mode while disarmed."""

    name: str
    custom: int
    base: int


_MODES: dict[AutopilotKind, tuple[FlightMode, ...]] = {
    "ardupilot": (
        FlightMode("STABILIZE", 0, 81),
        FlightMode("AUTO", 3, 89),
        FlightMode("GUIDED", 4, 89),
        FlightMode("LOITER", 5, 89),
        FlightMode("RTL", 6, 89),
        FlightMode("LAND", 9, 81),
    ),
    "px4": (
        FlightMode("POSCTL", 3 << 16, 81),
        FlightMode("STABILIZE", 7 << 16, 81),
        FlightMode("TAKEOFF", 4 << 16 | 2 << 24, 29),
        FlightMode("HOLD", 4 << 16 | 3 << 24, 29),
        FlightMode("MISSION", 4 << 16 | 4 << 24, 29),
        FlightMode("RTL", 4 << 16 | 5 << 24, 29),
        FlightMode("LAND", 4 << 16 | 6 << 24, 29),
    ),
}
_PX4_ALIASES = {"AUTO": "MISSION", "GUIDED": "HOLD", "LOITER": "HOLD"}


def mode_named(kind: AutopilotKind, name: str) -> FlightMode:
    """The mode of this name. AUTO, GUIDED and LOITER also name modes of PX4. Raises `ValueError`."""
    modes = {mode.name: mode for mode in _MODES[kind]}
    key = name.upper()
    if kind == "px4":
        key = _PX4_ALIASES.get(key, key)
    if key not in modes:
        raise ValueError(f"the simulated {kind} has no mode {name!r}; it has {', '.join(modes)}")
    return modes[key]


def mode_numbered(kind: AutopilotKind, custom: int) -> FlightMode | None:
    """The mode with this custom_mode number, or None."""
    return next((mode for mode in _MODES[kind] if mode.custom == custom), None)


class CopterMotion:
    """Position and velocity. `step` moves it to its target while it is airborne."""

    def __init__(self, home: Home) -> None:
        self.home = home
        self.north_m = 0.0
        self.east_m = 0.0
        self.height_m = 0.0
        self.north_m_s = 0.0
        self.east_m_s = 0.0
        self.climb_m_s = 0.0
        self.yaw_rad = 0.0
        self.airborne = False
        self.landing = False
        self.taking_off = False
        self._target: tuple[float, float, float] | None = None

    @property
    def at_target(self) -> bool:
        return self.target == self.here

    @property
    def velocity_ned_m_s(self) -> tuple[float, float, float]:
        """North, east, down."""
        return self.north_m_s, self.east_m_s, -self.climb_m_s

    @property
    def speed_m_s(self) -> float:
        """Horizontal speed."""
        return math.hypot(self.north_m_s, self.east_m_s)

    @property
    def heading_deg(self) -> float:
        return math.degrees(self.yaw_rad) % 360.0

    @property
    def here(self) -> tuple[float, float, float]:
        return self.north_m, self.east_m, self.height_m

    @property
    def target(self) -> tuple[float, float, float]:
        return self._target or self.here

    def distance_to_target_m(self) -> float:
        """Horizontal distance."""
        return math.hypot(self.target[0] - self.north_m, self.target[1] - self.east_m)

    def fly_to(self, north_m: float, east_m: float, height_m: float) -> None:
        self.landing = self.taking_off = False
        self._target = (north_m, east_m, height_m)

    def take_off_to(self, height_m: float) -> None:
        self.airborne = True
        self.fly_to(self.north_m, self.east_m, max(height_m, self.height_m))
        self.taking_off = True

    def hold(self) -> None:
        self.landing = self.taking_off = False
        self._target = None

    def land(self) -> None:
        self.landing, self.taking_off = True, False
        self._target = None

    def step(self, dt_s: float) -> None:
        """Move for `dt_s`; a target within reach is reached exactly."""
        self.north_m_s = self.east_m_s = self.climb_m_s = 0.0
        if not self.airborne:
            return
        if self.landing:
            speed = VERTICAL_M_S if self.height_m > FLARE_HEIGHT_M else TOUCHDOWN_M_S
            self._climb_towards(0.0, speed, dt_s)
            if self.height_m == 0.0:
                self.airborne = False
        elif self._target is not None:
            north_m, east_m, height_m = self._target
            self._climb_towards(height_m, VERTICAL_M_S, dt_s)
            self._cruise_towards(north_m, east_m, dt_s)

    def _climb_towards(self, height_m: float, speed_m_s: float, dt_s: float) -> None:
        gap_m = height_m - self.height_m
        if abs(gap_m) <= speed_m_s * dt_s:
            self.height_m = height_m
        else:
            self.climb_m_s = math.copysign(speed_m_s, gap_m)
            self.height_m += self.climb_m_s * dt_s

    def _cruise_towards(self, north_m: float, east_m: float, dt_s: float) -> None:
        to_north_m, to_east_m = north_m - self.north_m, east_m - self.east_m
        gap_m = math.hypot(to_north_m, to_east_m)
        if gap_m <= CRUISE_M_S * dt_s:
            self.north_m, self.east_m = north_m, east_m
            return
        self.yaw_rad = math.atan2(to_east_m, to_north_m)
        self.north_m_s = CRUISE_M_S * to_north_m / gap_m
        self.east_m_s = CRUISE_M_S * to_east_m / gap_m
        self.north_m += self.north_m_s * dt_s
        self.east_m += self.east_m_s * dt_s


class Leg:
    """Flies one item. Call `update` often, then read `arrived` (at the place) and `done` (after the hold).

    LAND and RTL are never done: disarming ends them.
    """

    def __init__(self, flight: CopterMotion, item: MissionItem, now_s: float) -> None:
        self.item = item
        self.arrived = False
        self.done = False
        self._flight = flight
        self._hold_until_s: float | None = None
        self._spooled_s: float | None = None
        self._route: list[tuple[float, float, float]] = []
        command = item.command
        if command in (TAKEOFF, VTOL_TAKEOFF):
            if flight.airborne:
                self._route = [(flight.north_m, flight.east_m, max(self._height_m(), flight.height_m))]
        elif command == RETURN:
            height_m = max(_RETURN_HEIGHT_M, flight.height_m)
            self._route = [(flight.north_m, flight.east_m, height_m), (0.0, 0.0, height_m)]
        elif command in (LAND, VTOL_LAND):
            self._route = [(*self._place(), flight.height_m)]
        elif command in (DELAY, CONDITION_DELAY, NAV_SCRIPT_TIME, GUIDED_ENABLE):
            flight.hold()
            self._hold_until_s = now_s + self._hold_s()
        else:
            self._route = [(*self._place(), self._height_m())]
        self._next_point()

    def _place(self) -> tuple[float, float]:
        x, y = self.item.params[4], self.item.params[5]
        if (x == 0.0 and y == 0.0) or not (math.isfinite(x) and math.isfinite(y)):
            return self._flight.north_m, self._flight.east_m
        return self._flight.home.local_m(x, y)

    def _height_m(self) -> float:
        z = self.item.params[6]
        if z == 0.0 or not math.isfinite(z):
            return self._flight.height_m
        return z - self._flight.home.altitude_amsl_m if self.item.frame in GLOBAL_FRAMES else z

    def _hold_s(self) -> float:
        command, (first, second) = self.item.command, self.item.params[:2]
        if command == LOITER_UNLIMITED:
            return math.inf
        if command == LOITER_TURNS:
            return first * _TURN_S
        if command == NAV_SCRIPT_TIME:
            return second or math.inf
        if command == GUIDED_ENABLE:
            return first or math.inf
        return first if first > 0.0 else 0.0

    def _next_point(self) -> None:
        if self._route and self._flight.airborne:
            self._flight.fly_to(*self._route[0])

    def update(self, now_s: float, armed: bool) -> None:
        if self.done or not armed:
            return
        flight = self._flight
        if self.item.command in (TAKEOFF, VTOL_TAKEOFF) and not flight.airborne:
            if self._spooled_s is None:
                self._spooled_s = now_s + _SPOOL_UP_S
            if now_s >= self._spooled_s:
                flight.take_off_to(self._height_m())
            return
        if self._hold_until_s is not None:
            self._hold(now_s, self._hold_until_s)
            return
        if not flight.airborne or not flight.at_target or flight.landing:
            return
        if self._route:
            self._route.pop(0)
            self._next_point()
        if not self._route:
            self._arrive(now_s)

    def _hold(self, now_s: float, until_s: float) -> None:
        if now_s < until_s:
            return
        if self.item.command != RETURN:
            self.done = True
        elif self._flight.airborne and not self._flight.landing:
            self._flight.land()

    def _arrive(self, now_s: float) -> None:
        self.arrived = True
        command = self.item.command
        if command in (LAND, VTOL_LAND):
            self._flight.land()
        elif command == RETURN:
            self._hold_until_s = now_s + _RETURN_HOLD_S
        elif command in (TAKEOFF, VTOL_TAKEOFF):
            self.done = True
        else:
            self._hold_until_s = now_s + self._hold_s()
            self.done = now_s >= self._hold_until_s
