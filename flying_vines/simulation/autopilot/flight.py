"""A copter as a point that moves at constant speed."""

from __future__ import annotations

import math

from missions.home import CRUISE_M_S, FLARE_HEIGHT_M, TOUCHDOWN_M_S, VERTICAL_M_S, Home


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
        return self._target is None or self._target == (self.north_m, self.east_m, self.height_m)

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
        if self._target is None:
            return 0.0
        return math.hypot(self._target[0] - self.north_m, self._target[1] - self.east_m)

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
