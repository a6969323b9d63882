"""The shape of a bent vine: a plane arc of constant curvature, from base to tip."""

from __future__ import annotations

import math
from typing import NamedTuple

STRAIGHT_RAD = 1e-6
"""Below this angle the formula of an arc loses precision. Then an approximation for small angles is used."""


class AxisPoint(NamedTuple):
    """A point on the vine's axis. The base is at 0, 0."""

    x_m: float
    """Towards the side to which the vine bends."""
    y_m: float
    """Along the base's direction."""
    heading_rad: float
    """0 is along the base's direction."""


def tip(angle_deg: float, length_m: float) -> AxisPoint:
    """The position of the tip: x = (1 − cos θ) L/θ, y = sin θ L/θ.

    Args:
        angle_deg: θ, the angle between tip and base.
        length_m: L, the length of the axis.
    """
    angle = math.radians(angle_deg)
    if abs(angle) < STRAIGHT_RAD:
        return AxisPoint(0.5 * angle * length_m, length_m, angle)
    radius_m = length_m / angle
    return AxisPoint((1.0 - math.cos(angle)) * radius_m, math.sin(angle) * radius_m, angle)


def axis(angle_deg: float, length_m: float, pieces: int = 40) -> list[AxisPoint]:
    """Evenly spaced points along the vine, from base to tip."""
    shares = (i / pieces for i in range(pieces + 1))
    return [tip(share * angle_deg, share * length_m) for share in shares]


def sides(
    angle_deg: float, length_m: float, diameter_m: float
) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
    """The outlines (x, y) of the inner and the outer side, from base to tip."""
    inner, outer = [], []
    for x_m, y_m, heading in axis(angle_deg, length_m):
        across = (0.5 * diameter_m * math.cos(heading), -0.5 * diameter_m * math.sin(heading))
        inner.append((x_m + across[0], y_m + across[1]))
        outer.append((x_m - across[0], y_m - across[1]))
    return inner, outer
