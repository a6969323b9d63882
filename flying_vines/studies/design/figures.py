"""The design guide's pictures: speeds and fronts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt

from flying_vines.physics import paper
from flying_vines.plots.style import BLUE, GREEN, LABEL_BOX, ORANGE, PURPLE, RED, finish, save
from flying_vines.studies.design.evaluate import Evaluation, Performance, front
from flying_vines.studies.design.show import words


def draw(evaluation: Evaluation, tried: Sequence[Evaluation], folder: Path) -> list[Path]:
    """Draw two PNGs into an existing folder. Returns their paths.

    Args:
        evaluation: of the robot's own parts.
        tried: every choice of the catalogue.
    """
    return save({"speed": _speed(evaluation), "search": _search(evaluation, tried)}, folder, "design")


def _speed(e: Evaluation) -> Any:
    figure, (speed, gain) = plt.subplots(1, 2, figsize=(11, 4.4), layout="constrained")
    robot = e.robot
    curves = [(e.inflation_curve_kPa_per_s, BLUE, "inflation (Eq. 4)")]
    if e.parts.venturi is not None:
        curves.append((e.deflation_curve_kPa_per_s, GREEN, "deflation, Venturi where it helps"))
    for curve, color, label in curves:
        speed.plot(e.reservoir_kPa, curve, color=color, lw=1.8, label=label)
    speed.axhline(e.passive_kPa_per_s, color=PURPLE, lw=1.4, ls="--", label="deflation, solenoid alone")
    wanted = robot.wanted_inflation_kPa_per_s
    speed.axhline(wanted, color=ORANGE, lw=1.4, ls=":", label=f"wanted: {wanted:.3g} kPa/s")
    if e.least_kPa < e.fill_kPa:
        speed.axvspan(0.0, e.least_kPa, color=RED, alpha=0.10, lw=0)
        speed.text(
            e.least_kPa + 0.012 * e.fill_kPa,
            0.99,
            f"too slow below {e.least_kPa:.0f} kPa",
            transform=speed.get_xaxis_transform(),
            color=RED,
            fontsize=8.5,
            va="top",
        )
    speed.set_ylabel("mean speed of a full swing, kPa/s")
    speed.legend(frameon=False, fontsize=8.5, loc="upper left", bbox_to_anchor=(0.0, 0.94))
    speed.set_ylim(0, 1.22 * max(float(np.max(curve)) for curve, _, _ in curves))

    ends_Hz = sorted((e.bandwidth_Hz, robot.cycle_rate_Hz))
    frequency_Hz = np.geomspace(0.5 * ends_Hz[0], 10.0 * ends_Hz[1], 400)
    for share, color in ((1.0, BLUE), (0.5, GREEN), (0.25, PURPLE)):
        cutoff_Hz = share * e.bandwidth_Hz
        gain.plot(
            frequency_Hz,
            paper.frequency_gain(frequency_Hz, cutoff_Hz),
            color=color,
            lw=1.8,
            label=f"P$_r$ = {share * e.fill_kPa:.0f} kPa: up to {cutoff_Hz:.3g} Hz",
        )
    gain.axvline(robot.cycle_rate_Hz, color=ORANGE, lw=1.4, ls=":")
    gain.text(
        robot.cycle_rate_Hz * 1.04,
        1.02,
        f"{robot.cycle_rate_Hz:.3g} Hz, its cycle",
        color=ORANGE,
        fontsize=8.5,
        va="bottom",
    )
    gain.set_xscale("log")
    gain.xaxis.set_major_formatter("{x:g}")
    gain.set_ylim(0, 1.12)
    gain.set_xlim(frequency_Hz[0], frequency_Hz[-1])
    gain.set_xlabel(f"frequency of {robot.swing_kPa:g} kPa peak to peak, Hz")
    gain.set_ylabel("gain (Eq. 6)")
    gain.legend(facecolor="white", edgecolor="none", framealpha=1.0, fontsize=8.5, loc="lower left")
    speed.set_xlim(0, e.fill_kPa)
    speed.set_xlabel("reservoir, kPa gauge")
    return finish(figure, f"{robot.name}: how fast ({robot.cv_kind} {robot.cv_volume_L:g} L)")


def _plot(axis: Any, by: Performance, some: Sequence[Evaluation], label: str, **look: Any) -> None:
    x, y = [e.mass_kg for e in some], [e.performance(by) for e in some]
    axis.plot(x, y, label=label, **{"ls": "none", "marker": "o", **look})


def _search(chosen: Evaluation, tried: Sequence[Evaluation]) -> Any:
    figure, axes = plt.subplots(1, 2, figsize=(11, 6.6), layout="constrained")
    scales: tuple[tuple[Performance, str], ...] = (
        ("cycles", "cycles from one filling"),
        ("inflation", "inflation speed from full, kPa/s"),
    )
    for axis, (by, label) in zip(axes, scales, strict=True):
        for venturi, color, name in ((True, BLUE, "with a Venturi"), (False, PURPLE, "passive venting")):
            for meets, text in ((False, "misses a requirement"), (True, "meets all requirements")):
                some = [e for e in tried if bool(e.missed) != meets and bool(e.parts.venturi) == venturi]
                look: dict[str, Any] = (
                    {"mfc": color, "alpha": 0.7} if meets else {"mfc": "white", "alpha": 0.45}
                )
                _plot(axis, by, some, f"{name}, {text} ({len(some)})", ms=4, mec=color, mew=0.7, **look)
        found = front(tried, by)
        _plot(axis, by, found, "Pareto front", ls="-", drawstyle="steps-post", lw=1.6, color=GREEN, ms=7)
        _plot(axis, by, [chosen], "the robot's parts", marker="*", ms=15, color=ORANGE, mec="white")
        for number, e in enumerate(found, 1):
            axis.annotate(
                str(number),
                (e.mass_kg, e.performance(by)),
                xytext=(-6, 5),
                textcoords="offset points",
                ha="right",
                color=GREEN,
                fontweight="bold",
                fontsize=9,
                bbox=LABEL_BOX,
            )
        key = "\n".join(f"{n}  {words(e.parts)}" for n, e in enumerate(found[:8], 1))
        axis.set_xlabel(f"mass of the phloSAR, kg\n\n{key}", loc="left", fontsize=8.5)
        axis.set_ylabel(label)
        axis.set_ylim(0, 1.08 * max(e.performance(by) for e in (*tried, chosen)) or 1.0)
        axis.margins(x=0.08)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, frameon=False, fontsize=8.5, ncols=3, loc="outside lower left")
    return finish(figure, f"{chosen.robot.name}: what the catalogue offers")
