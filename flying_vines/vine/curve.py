"""Bend angle against actuator pressure, as calibrated."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence


class BendCurve:
    """A rising, piecewise linear curve through calibrated pairs (gauge kPa, degrees).

    Below the first pair and above the last the curve stays flat. Where several pressures give one angle
    (a dead zone), the angle maps to the lowest of them.

    Raises `ValueError` with a sentence when there are fewer than two pairs, or when they do not rise.
    """

    def __init__(self, pairs: Sequence[tuple[float, float]]) -> None:
        if len(pairs) < 2:
            raise ValueError("the bend curve needs at least two pairs [kPa, deg]")
        self._pressures_kPa = [float(pressure) for pressure, _ in pairs]
        self._angles_deg = [float(angle) for _, angle in pairs]
        if not all(math.isfinite(x) for x in (*self._pressures_kPa, *self._angles_deg)):
            raise ValueError("the bend curve holds a value that is not a number")
        if any(b <= a for a, b in zip(self._pressures_kPa, self._pressures_kPa[1:], strict=False)):
            raise ValueError("the pressures of the bend curve must rise from pair to pair")
        if any(b < a for a, b in zip(self._angles_deg, self._angles_deg[1:], strict=False)):
            raise ValueError("the angles of the bend curve must not fall from pair to pair")

    @property
    def min_deg(self) -> float:
        return self._angles_deg[0]

    @property
    def max_deg(self) -> float:
        return self._angles_deg[-1]

    @property
    def max_kPa(self) -> float:
        """The highest calibrated pressure."""
        return self._pressures_kPa[-1]

    def angle_deg(self, pressure_kPa: float) -> float:
        """Bend angle at a gauge pressure."""
        return _interpolate(self._pressures_kPa, self._angles_deg, pressure_kPa, bisect_right)

    def pressure_kPa(self, angle_deg: float) -> float:
        """Gauge pressure for an angle, clipped to the calibrated range."""
        return _interpolate(self._angles_deg, self._pressures_kPa, angle_deg, bisect_left)


def _interpolate(
    xs: list[float], ys: list[float], x: float, side: Callable[[list[float], float], int]
) -> float:
    if x <= xs[0]:
        return ys[0]
    if x >= xs[-1]:
        return ys[bisect_left(xs, xs[-1])]
    i = min(max(side(xs, x), 1), len(xs) - 1)
    x0, x1 = xs[i - 1], xs[i]
    if x1 == x0:
        return ys[i - 1]
    return ys[i - 1] + (ys[i] - ys[i - 1]) * (x - x0) / (x1 - x0)
