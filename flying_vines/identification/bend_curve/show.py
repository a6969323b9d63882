"""A bend-curve fit on a terminal, as plain data, and as a figure."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from flying_vines.identification.bend_curve import BendCurveFit, CurveEstimate


def show(found: BendCurveFit, console: Console) -> None:
    """Print the fit, and the table for the configuration."""
    pairs = found.pairs
    up = int(np.sum(pairs.rising))
    console.print(f"{len(pairs.rising)} pairs, {up} on the way up, {len(pairs.rising) - up} on the way down")
    table = Table(box=None, padding=(0, 1), pad_edge=False)
    for heading in ("quantity", "unit", "value", "95 % interval"):
        table.add_column(heading, justify="right" if heading in ("value", "95 % interval") else "left")
    for what, unit, estimate in (
        ("maximum bend θ_max", "°", found.bend_max_deg),
        ("dead zone P_d", "kPa", found.dead_kPa),
        ("scale P_s", "kPa", found.scale_kPa),
        ("hysteresis h", "kPa", found.hysteresis_kPa),
    ):
        if estimate is None:
            table.add_row(what, unit, "–", "not known")
        else:
            table.add_row(what, unit, f"{estimate.value:.4g}", f"{estimate.low:.4g} … {estimate.high:.4g}")
    table.add_row(
        "residual, rms", "°", f"{found.rms_deg:.3g}", "" if found.follows_law else "of a free curve"
    )
    console.print(table)
    for note in found.notes:
        console.print(Text(f"· {note}", style="yellow"))
    console.print("\nFor the configuration:\n", style="bold")
    console.print(found.table, end="", markup=False, highlight=False, soft_wrap=True)


def as_json(found: BendCurveFit) -> dict[str, Any]:
    """Everything as plain lists, numbers and texts."""

    def plain(estimate: CurveEstimate | None) -> dict[str, float] | None:
        return None if estimate is None else estimate._asdict()

    return {
        "pairs": len(found.pairs.rising),
        "pairs_up": int(np.sum(found.pairs.rising)),
        "bend_max_deg": plain(found.bend_max_deg),
        "dead_kPa": plain(found.dead_kPa),
        "scale_kPa": plain(found.scale_kPa),
        "hysteresis_kPa": plain(found.hysteresis_kPa),
        "law_rms_deg": found.law_rms_deg,
        "follows_law": found.follows_law,
        "rms_deg": found.rms_deg,
        "vine": {
            "curve": [list(pair) for pair in found.curve],
            "hysteresis_kPa": found.written_hysteresis_kPa,
        },
        "notes": list(found.notes),
    }


def draw(found: BendCurveFit, folder: Path, title: str) -> list[Path]:
    """Draw measured pairs, fitted loop and residuals as one PNG into an existing folder. Returns its path."""
    from matplotlib import pyplot as plt

    from flying_vines.plots.style import BLUE, GREY, ORANGE, PURPLE, finish, save

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
                label = f"measured, {label} ({int(np.sum(which))})"
                axis.plot(kPa[which], values[which], marker, ms=5, mfc="white", mec=color, label=label)
    written = np.array(found.curve)
    bent, angles = written.T
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
    loop.plot(*written.T, "s", ms=4, color=PURPLE, label="pairs written")
    loop.set_ylabel("bend, °")
    loop.set_ylim(top=1.12 * max(float(np.max(deg)), float(angles[-1])))
    loop.legend(frameon=False, fontsize=9, loc="lower right")
    rest.axhline(0.0, color=GREY, lw=1.0)
    rest.set_ylabel(f"residual, °\n({found.rms_deg:.2f}° rms)")
    rest.set_xlabel("actuator, kPa gauge")
    return save({"fit": finish(figure, title)}, folder, "vine")
