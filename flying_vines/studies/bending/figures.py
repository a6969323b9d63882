"""Draws bending: angle and air over pressure, pull over contraction, and the vine itself."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt

from flying_vines.plots.style import BLUE, GREEN, GREY, LABEL_BOX, ORANGE, PURPLE, RED, finish, save
from flying_vines.plots.vine import draw_drone, draw_vine
from flying_vines.studies.bending.actuator import force_N, free
from flying_vines.studies.bending.equilibrium import BendingCurve

COLORS = (BLUE, GREEN, PURPLE, ORANGE, RED)
SHARES = (0.0, 0.25, 0.5, 1.0)
"""Shares of the usable pressure at which the vine is drawn."""


def draw(found: Sequence[BendingCurve], folder: Path) -> list[Path]:
    """Draw three PNGs into an existing folder. Returns their paths."""
    return save({"bend": _bend(found), "pull": _pull(found), "shape": _shape(found)}, folder, "vine")


def _bend(found: Sequence[BendingCurve]) -> Any:
    figure, (angle, air) = plt.subplots(1, 2, figsize=(12, 5), layout="constrained", width_ratios=[1.5, 1])
    for b, color in zip(found, _colors(found), strict=True):
        usable = b.pressure_kPa <= b.usable_kPa
        for axis, x, y in ((angle, b.pressure_kPa, b.angle_deg), (air, b.angle_deg, b.air_SL)):
            axis.plot(x, y, color=color, lw=1.2, ls=":")
            axis.plot(x[usable], y[usable], color=color, lw=2.0, label=b.vine.name)
        for limit in b.limits:
            if limit.pressure_kPa is None:
                continue
            kPa, deg = limit.pressure_kPa, b.at(b.angle_deg, limit.pressure_kPa)
            if limit.ends:
                angle.plot(kPa, deg, marker="o", ms=6, color=color)
                angle.annotate(
                    limit.name,
                    (kPa, deg),
                    xytext=(6, -11),
                    textcoords="offset points",
                    fontsize=8,
                    color=color,
                    bbox=LABEL_BOX,
                )
            else:
                angle.plot(kPa, deg, marker="|", ms=11, mew=1.6, color=color)
    angle.plot([], [], ls="none", marker="|", ms=11, mew=1.6, color=GREY, label="wrinkles from here on")
    angle.set_xlabel("actuator, kPa gauge")
    angle.set_ylabel("bend of the tip, °")
    angle.set_ylim(bottom=0)
    angle.set_xlim(left=0)
    angle.legend(frameon=False, loc="upper left", fontsize=9)
    air.set_xlabel("bend of the tip, °")
    air.set_ylabel("air in the actuator, SL")
    air.set_ylim(bottom=0)
    air.set_xlim(left=0)
    return finish(figure, "Bend over pressure, and air for a bend")


def _pull(found: Sequence[BendingCurve]) -> Any:
    figure, axes = plt.subplots(
        1, len(found), figsize=(4.2 * len(found), 4.4), sharey=True, layout="constrained", squeeze=False
    )
    for axis, b, color in zip(axes[0], found, _colors(found), strict=True):
        body, usable = b.vine.body, b.usable_kPa or b.vine.max_kPa
        axis.plot(
            100.0 * body.yielding.contraction, body.yielding.force_N, color=GREY, lw=1.8, label="body yields"
        )
        for force, name in ((body.wrinkling_N, "wrinkles"), (body.collapse_N, "folds")):
            axis.axhline(force, color=RED, lw=0.9, ls="--")
            axis.annotate(
                name,
                (1.0, force),
                xycoords=("axes fraction", "data"),
                ha="right",
                va="bottom",
                color=RED,
                fontsize=8,
            )
        widest = float(np.max(free(b.vine.actuator, usable).contraction))
        contraction = np.linspace(0.0, widest, 120)
        for share in SHARES[1:]:
            kPa = share * usable
            axis.plot(
                100.0 * contraction,
                force_N(b.vine.actuator, kPa, contraction),
                color=color,
                lw=1.4,
                alpha=0.35 + 0.65 * share,
                label=f"pulls at {kPa:.3g} kPa",
            )
            axis.plot(100.0 * b.at(b.contraction, kPa), b.at(b.force_N, kPa), "o", color=color, ms=5)
        axis.set_ylim(0, 2.2 * body.collapse_N)
        axis.set_xlim(0, 105.0 * widest)
        axis.set_title(b.vine.name, fontsize=10, color=color)
        axis.set_xlabel("contraction, %")
        axis.legend(frameon=False, fontsize=8, loc="upper right")
    axes[0][0].set_ylabel("pull, N")
    return finish(figure, "Balance of the actuator's pull and the body's resistance")


def _shape(found: Sequence[BendingCurve]) -> Any:
    figure, axes = plt.subplots(
        1, len(found), figsize=(4.2 * len(found), 4.4), layout="constrained", squeeze=False
    )
    for axis, b, color in zip(axes[0], found, _colors(found), strict=True):
        draw_drone(axis)
        for share in SHARES:
            kPa = share * b.usable_kPa
            deg = b.at(b.angle_deg, kPa)
            x, y = draw_vine(
                axis,
                deg,
                b.at(b.length_m, kPa),
                b.vine.body.diameter_mm / 1000.0,
                color,
                alpha=0.25 + 0.75 * share,
            )
            if share == 0.0:
                continue
            axis.annotate(
                f"{kPa:.3g} kPa, {deg:.0f}°",
                (x, y),
                xytext=(8, -10),
                textcoords="offset points",
                fontsize=8,
                bbox=LABEL_BOX,
            )
        axis.set_aspect("equal")
        axis.margins(0.12)
        axis.set_title(b.vine.name, fontsize=10, color=color)
        axis.set_xlabel("m")
    axes[0][0].set_ylabel("m, below the drone")
    return finish(figure, "The vine under the drone, to scale, within its usable range")


def _colors(found: Sequence[BendingCurve]) -> list[str]:
    return [COLORS[i % len(COLORS)] for i in range(len(found))]
