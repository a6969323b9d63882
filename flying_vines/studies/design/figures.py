"""The design guide's pictures: speeds, the fronts, the comparison."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt

from flying_vines.physics import paper
from flying_vines.plots.style import BLUE, GREEN, GREY, LABEL_BOX, ORANGE, PURPLE, RED, finish, save
from flying_vines.studies.design.compass import METRICS, Compass
from flying_vines.studies.design.evaluate import Evaluation
from flying_vines.studies.design.search import Performance, front, performance
from flying_vines.studies.design.show import words


def draw(
    evaluation: Evaluation,
    tried: Sequence[Evaluation],
    compared: Compass,
    folder: Path,
) -> list[Path]:
    """Draw three PNGs into an existing folder. Returns their paths.

    Args:
        evaluation: of the robot's own parts.
        tried: every choice of the catalogue.
        compared: the design among the paper's solutions.
    """
    figures = {
        "speed": _speed(evaluation),
        "search": _search(evaluation, tried),
        "compass": _compass(compared),
    }
    return save(figures, folder, "design")


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


def _search(chosen: Evaluation, tried: Sequence[Evaluation]) -> Any:
    figure, axes = plt.subplots(1, 2, figsize=(11, 6.6), layout="constrained")
    scales: tuple[tuple[Performance, str], ...] = (
        ("cycles", "cycles from one filling"),
        ("inflation", "inflation speed from full, kPa/s"),
    )
    for axis, (by, label) in zip(axes, scales, strict=True):
        for venturi, color, name in ((True, BLUE, "with a Venturi"), (False, PURPLE, "passive venting")):
            for meets, text in ((False, "misses a requirement"), (True, "meets all requirements")):
                some = [
                    e
                    for e in tried
                    if bool(e.shortfalls) != meets and (e.parts.venturi is not None) == venturi
                ]
                axis.plot(
                    [e.mass_kg for e in some],
                    [performance(e, by) for e in some],
                    ls="none",
                    marker="o",
                    ms=4,
                    mfc=color if meets else "white",
                    mec=color,
                    mew=0.7,
                    alpha=0.7 if meets else 0.45,
                    label=f"{name}, {text} ({len(some)})",
                )
        found = front(tried, by)
        axis.plot(
            [e.mass_kg for e in found],
            [performance(e, by) for e in found],
            color=GREEN,
            lw=1.6,
            drawstyle="steps-post",
            marker="o",
            ms=7,
            label="Pareto front",
        )
        axis.plot(
            chosen.mass_kg,
            performance(chosen, by),
            ls="none",
            marker="*",
            ms=15,
            color=ORANGE,
            mec="white",
            label="the robot's parts",
        )
        for number, e in enumerate(found, 1):
            axis.annotate(
                str(number),
                (e.mass_kg, performance(e, by)),
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
        axis.set_ylim(0, 1.08 * max(performance(e, by) for e in (*tried, chosen)) or 1.0)
        axis.margins(x=0.08)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, frameon=False, fontsize=8.5, ncols=3, loc="outside lower left")
    return finish(figure, f"{chosen.robot.name}: what the catalogue offers")


def _compass(compared: Compass) -> Any:
    columns: list[tuple[str, Mapping[str, float | None], Mapping[str, bool], str]] = []
    judgements: dict[str, dict[str, bool]] = {}
    for name, solution in compared.solutions.items():
        ratings = {metric: solution.rating(metric) for metric in METRICS}
        judgements[name] = {metric: r is not None and r.judgement for metric, r in ratings.items()}
        columns.append(
            (
                solution.label.replace(" regulator", "\nregulator"),
                {metric: None if r is None else r.value for metric, r in ratings.items()},
                judgements[name],
                BLUE,
            )
        )
    # The design's ratings are the phloSAR's, scaled. So they are judgements where the phloSAR's are.
    columns.append(("your design", compared.design, judgements["phlosar"], ORANGE))
    figure, axes = plt.subplots(1, len(columns), figsize=(12, 3.8), sharey=True, layout="constrained")
    for axis, (label, values, judged, color) in zip(axes, columns, strict=True):
        for place, metric in enumerate(METRICS):
            value = values[metric]
            if value is None:
                axis.text(0.15, place, "no value", color=GREY, va="center", fontsize=8)
                continue
            face = "white" if judged[metric] else color
            axis.barh(place, value, 0.62, color=face, edgecolor=color, lw=1.1)
        axis.set_title(label, fontsize=9.5, color=color, va="bottom")
        axis.set_xlim(0, 5.15)
        axis.set_xticks([1, 3, 5])
    axes[0].set_yticks(range(len(METRICS)), [metric.replace("_", " ") for metric in METRICS])
    axes[0].invert_yaxis()
    figure.supxlabel(
        "1 worst … 5 best (of cost, weight and size, less is better). "
        "Filled: from a sentence of the paper; open: our judgement. "
        "Your design: the phloSAR's ratings, scaled",
        fontsize=9,
    )
    return finish(figure, "Pressure supplies and regulators (after the paper's Fig. 2)")
