"""Draws the diagnosis: measured and simulated discharges, and the gains."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt

from flying_vines.plots.style import BLUE, GREEN, GREY, ORANGE, PURPLE, finish, save
from flying_vines.studies.paper.compare import BAND
from flying_vines.studies.paper.data import condition, curve, stated
from flying_vines.studies.paper.diagnosis import PaperDiagnosis
from flying_vines.studies.paper.diagnosis.discharge import RESERVOIR, VOLUME_L, Discharges
from flying_vines.studies.paper.diagnosis.response import FLOOR, TESTS, Responses


def draw(diagnosis: PaperDiagnosis, folder: Path) -> list[Path]:
    """Draw two PNGs into an existing folder. Returns their paths."""
    plots = {"discharge": _discharge(diagnosis.discharges), "frequency": _frequency(diagnosis.responses)}
    return save(plots, folder, "paper-diagnosis")


def _discharge(found: Discharges) -> Any:
    figure, axes = plt.subplots(
        2, 3, figsize=(11, 5.8), sharey="row", height_ratios=[2.0, 1.2], layout="constrained"
    )
    for index, run in enumerate(found.verdict.evidence.runs):
        above, below = axes[0, index], axes[1, index]
        measured_kPa = run.measured_kPa[RESERVOIR]
        for kPa, color, label in (
            (run.baseline_kPa[RESERVOIR], ORANGE, "baseline"),
            (run.extended_kPa[RESERVOIR], PURPLE, "more flow"),
        ):
            above.plot(run.time_s, kPa, color=color, lw=1.6, label=label)
            off = 100.0 * (measured_kPa - kPa) / float(measured_kPa[0])
            below.plot(run.time_s, off, color=color, lw=1.2, marker="o", ms=3)
        above.plot(run.time_s, measured_kPa, "o", color=BLUE, ms=3.5, label="measured")
        setting = "high" if "high" in run.run else "low"
        above.set_title(f"{VOLUME_L[run.run]:g} L, {setting} R$_v$", loc="left", fontsize=10)
        above.set_ylim(0, 720)
        below.axhline(0.0, color="black", lw=0.6)
        below.set_xlabel("time, s")
    axes[0, 0].set_ylabel("reservoir, kPa gauge")
    axes[1, 0].set_ylabel("measured − simulated,\n% of the first reading")
    axes[0, 2].legend(frameon=False, fontsize=9)
    return finish(figure, "The paper's discharges: measured, simulated, residuals")


def _frequency(responses: Responses) -> Any:
    figure, axes = plt.subplots(
        2, 2, figsize=(11, 6.0), sharex=True, sharey="row", height_ratios=[2, 1], layout="constrained"
    )
    shown = (
        (responses.of(), ORANGE, "baseline"),
        (responses.of("tube"), GREEN, "with a tube"),
        (responses.of(FLOOR), PURPLE, "with a floor of the evaluation"),
    )
    for index, test in enumerate(TESTS):
        above, below = axes[0, index], axes[1, index]
        measured = curve(f"frequency_measured_{test}")
        order = np.argsort(measured.x)
        for explanation, color, label in shown:
            gains = explanation.gains[index]
            above.plot(measured.x[order], gains[order], color=color, lw=1.5, label=label)
            off = 20.0 * np.log10(measured.y / gains)
            below.plot(measured.x[order], off[order], color=color, lw=1.2, marker="o", ms=3)
        above.plot(measured.x, measured.y, "o", color=BLUE, ms=4, label="measured")
        tested = condition(test)
        above.set_title(
            f"{test.upper()}: {tested.swing_kPa:.0f} kPa peak to peak, {tested.cv_volume_L:g} L on "
            f"{tested.reservoir_kPa:.0f} kPa",
            loc="left",
            fontsize=10,
        )
        above.set_xscale("log")
        above.set_yscale("log")
        above.set_yticks([0.02, 0.05, 0.1, 0.2, 0.5, 1.0], ["0.02", "0.05", "0.1", "0.2", "0.5", "1"])
        above.set_yticks([], minor=True)
        below.set_xticks([0.1, 1, 10], ["0.1", "1", "10"])
        below.axhline(0.0, color="black", lw=0.6)
        below.set_xlabel("command frequency, Hz")
        for axis in (above, below):
            axis.axvline(BAND * stated()[f"{test}.cutoff_drawn"].value, color=GREY, lw=0.8, ls=":")
    axes[0, 0].set_ylabel("gain")
    axes[1, 0].set_ylabel("measured over simulated, dB")
    axes[0, 0].legend(frameon=False, fontsize=9)
    return finish(figure, "The paper's frequency responses (dotted: three cut-offs of its model)")
