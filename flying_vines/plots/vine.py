"""Draws a bent vine under its drone, to scale."""

from __future__ import annotations

from typing import Any

from matplotlib.patches import Polygon

from flying_vines.plots.style import GREY
from flying_vines.vine.shape import sides

DRONE_M = 0.22
"""Distance between the rotor axes: a frame for 13 cm propellers."""
ROTOR_M = 0.13


def draw_drone(axis: Any) -> None:
    """Draw a drone from the front, with its underside at (0, 0)."""
    half = 0.5 * DRONE_M
    axis.plot([-half, half], [0.02, 0.02], color=GREY, lw=2.2, solid_capstyle="round")
    axis.add_patch(
        Polygon([(-0.035, 0.0), (0.035, 0.0), (0.03, 0.045), (-0.03, 0.045)], facecolor=GREY, lw=0)
    )
    for x in (-half, half):
        axis.plot([x, x], [0.02, 0.05], color=GREY, lw=1.4)
        axis.plot([x - 0.5 * ROTOR_M, x + 0.5 * ROTOR_M], [0.052, 0.052], color=GREY, lw=1.6)


def draw_vine(
    axis: Any, angle_deg: float, length_m: float, diameter_m: float, color: str, **line: Any
) -> tuple[float, float]:
    """Draw a vine that hangs from (0, 0), bent to the right. Returns the tip's position in metres."""
    inner, outer = sides(angle_deg, length_m, diameter_m)
    outline = [(x, -y) for x, y in (*inner, *reversed(outer))]
    axis.add_patch(Polygon(outline, closed=True, facecolor=color, edgecolor="none", alpha=0.16))
    axis.add_patch(Polygon(outline, closed=True, fill=False, edgecolor=color, lw=0.9))
    axis.plot([x for x, _ in inner], [-y for _, y in inner], color=color, lw=2.6, **line)
    (a, b), (c, d) = inner[-1], outer[-1]
    return 0.5 * (a + c), -0.5 * (b + d)


def frame(axis: Any, length_m: float, diameter_m: float) -> None:
    """Set the limits of an axis to scale, with room for any bend, and hide the axis."""
    axis.set_xlim(-0.5 * (DRONE_M + ROTOR_M) - 0.02, max(0.5 * (DRONE_M + ROTOR_M), length_m * 0.8))
    axis.set_ylim(-length_m - diameter_m, 0.08)
    axis.set_aspect("equal")
    axis.set_axis_off()
