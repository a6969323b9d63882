"""Bend angle against actuator pressure, as calibrated, with hysteresis.

Film and fabric rub, so an angle needs a lower pressure during deflation than during inflation. The model is a
play operator (backlash), the simplest Prandtl-Ishlinskii operator. A bend is given as the pressure that
makes it during inflation: `bent_kPa`. A pressure above `bent_kPa` bends the vine further. A pressure that is
lower by at most `hysteresis_kPa` changes nothing. A still lower pressure straightens the vine.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence


class BendCurve:
    """A rising, piecewise linear curve through calibrated pairs (gauge kPa, degrees).

    The curve is flat below the first pair and above the last pair. If several pressures give one angle
    (a dead zone), the angle maps to the lowest of them. The pairs are of an inflation. During a deflation
    the pressure for each angle is lower by `hysteresis_kPa`.

    Raises `ValueError` with a sentence if there are fewer than two pairs, if a value is not finite, if the
    pressures do not rise, if an angle falls, or if the hysteresis is negative or not narrower than the curve.
    """

    def __init__(self, pairs: Sequence[tuple[float, float]], hysteresis_kPa: float = 0.0) -> None:
        if len(pairs) < 2:
            raise ValueError("the bend curve needs at least two pairs [kPa, deg]")
        self._pressures_kPa = [float(pressure) for pressure, _ in pairs]
        self._angles_deg = [float(angle) for _, angle in pairs]
        if not all(math.isfinite(x) for x in (*self._pressures_kPa, *self._angles_deg)):
            raise ValueError("every value of the bend curve must be a finite number")
        if any(b <= a for a, b in zip(self._pressures_kPa, self._pressures_kPa[1:], strict=False)):
            raise ValueError("the pressures of the bend curve must rise from pair to pair")
        if any(b < a for a, b in zip(self._angles_deg, self._angles_deg[1:], strict=False)):
            raise ValueError("the angles of the bend curve must not fall from pair to pair")
        if not 0.0 <= hysteresis_kPa < self._pressures_kPa[-1] - self._pressures_kPa[0]:
            raise ValueError("the hysteresis must be 0 or more, and narrower than the bend curve")
        self.hysteresis_kPa = hysteresis_kPa

    @property
    def min_deg(self) -> float:
        return self._angles_deg[0]

    @property
    def max_deg(self) -> float:
        return self._angles_deg[-1]

    @property
    def max_kPa(self) -> float:
        return self._pressures_kPa[-1]

    def bent_kPa(self, pressure_kPa: float, before_kPa: float) -> float:
        """The bend at a pressure, as the pressure that makes this bend during inflation.

        Args:
            pressure_kPa: present gauge pressure.
            before_kPa: the previous bend, in the same form.
        """
        return min(max(before_kPa, pressure_kPa), pressure_kPa + self.hysteresis_kPa)

    def toward_kPa(self, wanted_kPa: float, bent_kPa: float) -> float:
        """The gauge pressure that brings the vine from bend `bent_kPa` to bend `wanted_kPa`.

        This pressure is never negative. So with a wide hysteresis some bend remains at 0 kPa.
        """
        return wanted_kPa if wanted_kPa > bent_kPa else max(0.0, wanted_kPa - self.hysteresis_kPa)

    def angle_deg(self, pressure_kPa: float) -> float:
        """Bend angle at a gauge pressure during inflation."""
        return _interpolate(self._pressures_kPa, self._angles_deg, pressure_kPa, bisect_right)

    def pressure_kPa(self, angle_deg: float) -> float:
        """Gauge pressure for an angle during inflation, clipped to the calibrated range."""
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
