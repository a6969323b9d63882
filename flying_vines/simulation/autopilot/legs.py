"""Flies one navigation command."""

from __future__ import annotations

import math

from flying_vines.simulation.autopilot.flight import CopterMotion
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
    MissionItem,
)

_SPOOL_UP_S = 2.0
_TURN_S = 10.0
_RETURN_HEIGHT_M = 15.0
_RETURN_HOLD_S = 5.0


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
        self._plan(now_s)

    def _plan(self, now_s: float) -> None:
        flight, command = self._flight, self.item.command
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
