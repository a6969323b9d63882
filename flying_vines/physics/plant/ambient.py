"""Ambient air: pressure and temperature over time.

`at(t_s)` gives absolute pressure in kPa, temperature in K, and the rate of the pressure in kPa/s.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from typing import NamedTuple

from flying_vines.physics.gas import STANDARD_PRESSURE_KPA, STANDARD_TEMPERATURE_K


class Air(NamedTuple):
    """Ambient air during a short time with linear changes: absolute pressure, temperature ratio, rates."""

    kPa: float
    kPa_per_s: float
    ratio: float
    """Temperature over 293.15 K, at the start."""
    ratio_per_s: float


@dataclass(frozen=True)
class Steady:
    """Constant ambient air."""

    pressure_kPa: float = STANDARD_PRESSURE_KPA
    temperature_K: float = STANDARD_TEMPERATURE_K

    def at(self, t_s: float) -> tuple[float, float, float]:
        return self.pressure_kPa, self.temperature_K, 0.0


LOWEST_KPA, HIGHEST_KPA = 47.0, 109.0
"""Ambient pressure 6000 m above and 600 m below sea level: the limits of a climb."""


@dataclass(frozen=True)
class Climb:
    """Pressure falls at a constant rate from t = 0 on, until it reaches the limits of ambient pressure."""

    falls_kPa_per_s: float
    pressure_kPa: float = STANDARD_PRESSURE_KPA
    temperature_K: float = STANDARD_TEMPERATURE_K

    def at(self, t_s: float) -> tuple[float, float, float]:
        kPa = self.pressure_kPa - self.falls_kPa_per_s * t_s
        if LOWEST_KPA <= kPa <= HIGHEST_KPA:
            return kPa, self.temperature_K, -self.falls_kPa_per_s
        return min(max(kPa, LOWEST_KPA), HIGHEST_KPA), self.temperature_K, 0.0


@dataclass(frozen=True)
class Recorded:
    """Recorded ambient air, linear between samples; constant before the first and after the last."""

    time_s: tuple[float, ...]
    pressure_kPa: tuple[float, ...]
    temperature_K: tuple[float, ...]

    def __post_init__(self) -> None:
        if not len(self.time_s) == len(self.pressure_kPa) == len(self.temperature_K) > 0:
            raise ValueError("times, pressures and temperatures must have the same length, at least 1")
        if any(later <= earlier for earlier, later in zip(self.time_s, self.time_s[1:], strict=False)):
            raise ValueError("times must rise")

    def at(self, t_s: float) -> tuple[float, float, float]:
        after = bisect_right(self.time_s, t_s)
        if after == 0 or after == len(self.time_s):
            end = min(after, len(self.time_s) - 1)
            return self.pressure_kPa[end], self.temperature_K[end], 0.0
        before = after - 1
        span_s = self.time_s[after] - self.time_s[before]
        share = (t_s - self.time_s[before]) / span_s
        rise_kPa = self.pressure_kPa[after] - self.pressure_kPa[before]
        rise_K = self.temperature_K[after] - self.temperature_K[before]
        pressure_kPa = self.pressure_kPa[before] + share * rise_kPa
        return pressure_kPa, self.temperature_K[before] + share * rise_K, rise_kPa / span_s


Ambient = Steady | Climb | Recorded


def air_at(ambient: Ambient, t_s: float) -> Air:
    """The air at an instant."""
    kPa, kelvin, kPa_per_s = ambient.at(t_s)
    return Air(kPa, kPa_per_s, kelvin / STANDARD_TEMPERATURE_K, 0.0)


def air_between(before: Air, after: Air, dt_s: float) -> Air:
    """The air from one instant to another `dt_s` later."""
    return Air(before.kPa, (after.kPa - before.kPa) / dt_s, before.ratio, (after.ratio - before.ratio) / dt_s)
