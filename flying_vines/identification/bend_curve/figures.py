"""Draws a bend-curve fit: the measured pairs up and down, the fitted loop, and the residuals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt

from flying_vines.identification.bend_curve.fit import BendCurveFit
from flying_vines.plots.style import BLUE, GREY, ORANGE, PURPLE, finish, save


def draw(found: BendCurveFit, folder: Path, title: str) -> list[Path]:
    """Draw one PNG into an existing folder. Returns its path."""
    return save({"fit": _fit(found, title)}, folder, "vine")


def _fit(found: BendCurveFit, title: str) -> Any:
    figure, (loop, rest) = plt.subplots(
        2, 1, figsize=(8, 7), sharex=True, height_ratios=[3, 1], layout="constrained"
    )
    kPa, deg, rising = found.pairs.pressure_kPa, found.pairs.angle_deg, found.pairs.rising
    for axis, values in ((loop, deg), (rest, found.residual_deg)):
        for which, color, marker, label in (
            (rising, BLUE, "^", "way up"),
            (~rising, ORANGE, "v", "way down"),
        ):
            if np.any(which):
                axis.plot(
                    kPa[which],
                    values[which],
                    ls="none",
                    marker=marker,
                    ms=5,
                    mfc="white",
                    mec=color,
                    label=f"measured, {label} ({int(np.sum(which))})",
                )
    bent, angles = np.array(found.curve).T
    top_kPa, width = float(bent[-1]), found.hysteresis_kPa.value if found.hysteresis_kPa else 0.0
    fine = np.linspace(0.0, top_kPa, 400)
    if found.follows_law:
        bent, angles = fine, found.law.curve_deg(fine)
    else:
        loop.plot(
            fine, found.law.curve_deg(fine), color=GREY, lw=1.2, ls=":", label="exponential law, not used"
        )
    loop.plot(bent, angles, color=BLUE, lw=1.8, label="fitted, way up")
    if found.hysteresis_kPa is not None:
        h = found.hysteresis_kPa
        loop.plot(np.maximum(0.0, bent - width), angles, color=ORANGE, lw=1.8, label="fitted, way down")
        loop.plot([top_kPa - width, top_kPa], [angles[-1]] * 2, color=GREY, lw=1.2, ls="--")
        loop.annotate(
            f"hysteresis {h.value:.2f} kPa ({h.low:.2f}…{h.high:.2f})",
            (top_kPa - 0.5 * width, angles[-1]),
            xytext=(0, 8),
            textcoords="offset points",
            ha="right",
            fontsize=9,
            color=GREY,
        )
    written = np.array(found.curve)
    loop.plot(written[:, 0], written[:, 1], ls="none", marker="s", ms=4, color=PURPLE, label="pairs written")
    loop.set_ylabel("bend, °")
    loop.set_ylim(top=1.12 * max(float(np.max(deg)), float(angles[-1])))
    loop.legend(frameon=False, fontsize=9, loc="lower right")
    rest.axhline(0.0, color=GREY, lw=1.0)
    rest.set_ylabel(f"residual, °\n({found.rms_deg:.2f}° rms)")
    rest.set_xlabel("actuator, kPa gauge")
    return finish(figure, title)
