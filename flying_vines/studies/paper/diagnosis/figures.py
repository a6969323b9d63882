"""Draws the diagnosis: measured and simulated discharges, the proposed experiment, the gains."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt

from flying_vines.plots.style import BLUE, GREEN, GREY, ORANGE, PURPLE, RED, finish, save
from flying_vines.studies.paper.compare import BAND
from flying_vines.studies.paper.data import condition, curve, stated
from flying_vines.studies.paper.diagnosis import PaperDiagnosis
from flying_vines.studies.paper.diagnosis.correlated import RESERVOIR
from flying_vines.studies.paper.diagnosis.discharge import VOLUME_L, DischargeModel, Discharges
from flying_vines.studies.paper.diagnosis.experiment import ExperimentProposal
from flying_vines.studies.paper.diagnosis.response import FLOOR, TESTS, Responses

COLORS = (PURPLE, GREEN, RED, ORANGE, GREY)


def draw(diagnosis: PaperDiagnosis, folder: Path) -> list[Path]:
    """Draw three PNGs into an existing folder. Returns their paths."""
    plots = {
        "discharge": _discharge(diagnosis.discharges),
        "experiment": _experiment(diagnosis.proposal),
        "frequency": _frequency(diagnosis.responses),
    }
    return save(plots, folder, "paper-diagnosis")


def _discharge(found: Discharges) -> Any:
    figure, axes = plt.subplots(
        2, 3, figsize=(11, 5.8), sharey="row", height_ratios=[2.0, 1.2], layout="constrained"
    )
    models = (
        (found.null, ORANGE, "baseline"),
        (found.of("evp_restriction"), GREY, "more flow"),
        (found.named, PURPLE, "more flow, and gas that cools"),
    )
    for index, run in enumerate(found.case.runs):
        above, below = axes[0, index], axes[1, index]
        first_kPa = float(run.reservoir_kPa[0])
        for candidate, color, label in models:
            kPa = _nearest_kPa(candidate, index)
            above.plot(run.time_s, kPa, color=color, lw=1.6, label=label)
            off = 100.0 * (run.reservoir_kPa - kPa) / first_kPa
            below.plot(run.time_s, off, color=color, lw=1.2, marker="o", ms=3)
        above.plot(run.time_s, run.reservoir_kPa, "o", color=BLUE, ms=3.5, label="measured")
        setting = "high" if "high" in run.name else "low"
        above.set_title(f"{VOLUME_L[run.name]:g} L, {setting} R$_v$", loc="left", fontsize=10)
        above.set_ylim(0, 720)
        below.axhline(0.0, color="black", lw=0.6)
        below.set_xlabel("time, s")
    axes[0, 0].set_ylabel("reservoir, kPa gauge")
    axes[1, 0].set_ylabel("measured − simulated,\n% of the first reading")
    axes[0, 2].legend(frameon=False, fontsize=9)
    return finish(figure, "The paper's discharges: measured, simulated, residuals")


def _nearest_kPa(candidate: DischargeModel, index: int) -> Any:
    return candidate.plain.simulated(candidate.nearest)[index][RESERVOIR]


def _experiment(proposal: ExperimentProposal) -> Any:
    best = proposal.best
    figure, axes = plt.subplot_mosaic(
        [["read", "apart"], ["off", "apart"]], figsize=(11, 5.4), width_ratios=[2, 1], layout="constrained"
    )
    read, off, apart = axes["read"], axes["off"], axes["apart"]
    for axis in (read, off):
        for begins, ends in best.experiment.open_s:
            axis.axvspan(begins, ends, color="#eef1f5", lw=0)
    first = next(iter(best.expected_kPa.values()))
    for (names, kPa), color in zip(best.expected_kPa.items(), COLORS, strict=False):
        read.plot(best.time_s, kPa, color=color, lw=1.3, marker="o", ms=3, label=" + ".join(names))
        off.plot(best.time_s, kPa - first, color=color, lw=1.3, marker="o", ms=3)
    read.set_ylabel("reservoir, kPa gauge")
    read.set_ylim(0, 720)
    read.legend(frameon=False, fontsize=8.5, loc="upper right")
    off.set_ylabel("off the first, kPa")
    off.set_xlabel("time, s (grey: valve open)")
    experiments = [outcome.experiment.name for outcome in proposal.outcomes]
    lowest = [outcome.worst.delta_chi2 for outcome in proposal.outcomes]
    bars = apart.barh(experiments, lowest, color=[PURPLE if o is best else GREY for o in proposal.outcomes])
    apart.bar_label(bars, fmt="%.1f", padding=3, fontsize=9)
    apart.invert_yaxis()
    apart.set_xlabel("lowest Δχ² of all pairs")
    apart.set_xlim(0, 1.2 * max(lowest))
    return finish(figure, "Expected readings in the experiment that separates the explanations")


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
        for account, color, label in shown:
            gains = account.gains[index]
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
