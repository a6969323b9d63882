"""A leak's flow as any function of pressure. It becomes a curve of straight lines for the compiled plant.

rig.with_effects(cv_leak_curve=curve_of(lambda p_kPa: 1e-4 * max(0.0, p_kPa - 12.0) ** 0.5))
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

PIECES = 64
"""Number of straight lines in a curve. They end at up_to · (i/PIECES)², so the first ones are short."""


class CurveNumbers(NamedTuple):
    """The numbers of a curve. The defaults are no flow."""

    up_to_kPa: float = 0.0
    steepest_SL_per_s_kPa: float = 0.0
    """Maximum change of the flow per kPa."""
    flow_SL_per_s: tuple[float, ...] = (0.0,) * (PIECES + 1)


def curve_SL_per_s(curve: CurveNumbers, gauge_kPa: float) -> float:
    """Flow out; below ambient pressure the same flow comes in. Beyond the curve its last line continues."""
    pressure = abs(gauge_kPa)
    piece = min(int(PIECES * math.sqrt(pressure / curve.up_to_kPa)), PIECES - 1)
    unit = curve.up_to_kPa / PIECES**2
    into = (pressure - unit * piece**2) / (unit * (2 * piece + 1))
    before = curve.flow_SL_per_s[piece]
    flow = before + into * (curve.flow_SL_per_s[piece + 1] - before)
    return flow if gauge_kPa >= 0.0 else -flow


@dataclass(frozen=True)
class Curve:
    """A leak to ambient by points: gauge pressure in kPa, flow in SL/s. The first is 0, 0."""

    points: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        if len(self.points) < 2 or self.points[0] != (0.0, 0.0):
            raise ValueError("a leak's curve needs its points, the first at 0 kPa without flow")
        for (p1, q1), (p2, q2) in pairwise(self.points):
            if not p1 < p2 < math.inf:
                raise ValueError(f"the pressures of a leak's curve must rise: {p2:g} kPa is after {p1:g} kPa")
            if not q1 <= q2 < math.inf:
                raise ValueError(f"the flow of a leak's curve must not fall: at {p2:g} kPa it is {q2:g} SL/s")

    @property
    def numbers(self) -> CurveNumbers:
        """The curve at the ends of its pieces."""
        up_to_kPa = self.points[-1][0]
        flow = tuple(map(self._flow_SL_per_s, _ends_kPa(up_to_kPa)))
        lines = zip(pairwise(_ends_kPa(up_to_kPa)), pairwise(flow), strict=True)
        return CurveNumbers(up_to_kPa, max((q2 - q1) / (p2 - p1) for (p1, p2), (q1, q2) in lines), flow)

    def _flow_SL_per_s(self, gauge_kPa: float) -> float:
        """The flow at a pressure, interpolated between two points."""
        after = min(bisect_right(self.points, (gauge_kPa, math.inf)), len(self.points) - 1)
        (p1, q1), (p2, q2) = self.points[after - 1 : after + 1]
        return q1 + (q2 - q1) * (gauge_kPa - p1) / (p2 - p1)


def curve_of(flow_SL_per_s: Callable[[float], float], up_to_kPa: float = 200.0) -> Curve:
    """The curve of a function from gauge pressure in kPa to flow in SL/s (20 °C, 101.325 kPa).

    The function is called at 65 pressures from 0 to `up_to_kPa`, closer together near 0. Beyond them the
    last line continues; below ambient pressure the same flow comes in. ValueError if the flow at 0 kPa
    is not 0, or if the flow falls or is infinite anywhere.
    """
    return Curve(tuple((p, float(flow_SL_per_s(p))) for p in _ends_kPa(up_to_kPa)))


def _ends_kPa(up_to_kPa: float) -> list[float]:
    return [up_to_kPa * (end / PIECES) ** 2 for end in range(PIECES + 1)]
