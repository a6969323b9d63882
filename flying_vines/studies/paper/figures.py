"""Draws the paper's figures with the measurement, the paper's model and ours, and the diagnosis."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt

from flying_vines.physics.arrays import Array
from flying_vines.plots.style import BLUE, GREEN, GREY, ORANGE, PURPLE, finish, save
from flying_vines.studies.paper.compare import BAND, STEP_TEST_S, Curves, FrequencyResponse
from flying_vines.studies.paper.data import condition, curve, stated
from flying_vines.studies.paper.diagnosis import PaperDiagnosis
from flying_vines.studies.paper.diagnosis.discharge import RESERVOIR, VOLUME_L, Discharges
from flying_vines.studies.paper.diagnosis.response import FLOOR, TESTS, Responses

MEASURED: dict[str, Any] = {"color": BLUE, "ls": "none", "marker": "o", "ms": 4, "label": "measured"}
MODEL: dict[str, Any] = {"color": ORANGE, "lw": 1.8, "label": "paper's model"}
PLANT: dict[str, Any] = {"color": GREEN, "lw": 1.4, "label": "ours (baseline plant)"}
LIKELY: dict[str, Any] = {"color": PURPLE, "lw": 1.4, "label": "ours (high-fidelity plant)"}


def draw(curves: Curves, folder: Path) -> list[Path]:
    """Draw five PNGs into an existing folder. Returns their paths, in the paper's order."""
    plots = {
        "discharge": _discharge,
        "inflation": _inflation,
        "frequency": _frequency,
        "sine": _sine,
        "cycles": _cycles,
    }
    return save({name: plot(curves) for name, plot in plots.items()}, folder, "paper")


def _discharge(curves: Curves) -> Any:
    figure, axes = plt.subplots(
        2, 3, figsize=(11, 5.6), sharey="row", height_ratios=[2.2, 1.0], layout="constrained"
    )
    for d, above, below in zip(curves.discharges, axes[0], axes[1], strict=True):
        time_s, measured = d.measured.x, d.measured.y
        above.plot(d.model.x, d.model.y, **MODEL)
        above.plot(d.plant_time_s, d.plant_kPa, **{**PLANT, "ls": (0, (2, 4)), "lw": 2.4})
        above.plot(d.plant_time_s, d.likely_kPa, **LIKELY)
        nearest = f"nearest exponential, τ = {d.best_time_constant_s:.1f} s"
        above.plot(
            d.plant_time_s,
            d.exponential_kPa(d.plant_time_s, d.best_time_constant_s),
            color=GREY,
            lw=1.0,
            label=nearest,
        )
        above.plot(time_s, measured, **MEASURED)
        above.set_title(
            f"{d.label.replace('R_v', 'R$_v$')}: drawn τ = {d.time_constant_s:.1f} s", loc="left", fontsize=10
        )
        above.legend(frameon=False, fontsize=8)
        above.set_ylim(0, 720)
        for tau_s, style, marker in (
            (d.time_constant_s, ORANGE, "o"),
            (d.best_time_constant_s, GREY, "."),
        ):
            off = measured - d.exponential_kPa(time_s, tau_s)
            below.plot(time_s, 100.0 * off / measured[0], color=style, lw=1.0, marker=marker, ms=3.5)
        off = measured - d.at_points(d.likely_kPa)
        below.plot(time_s, 100.0 * off / measured[0], color=PURPLE, lw=1.0, marker=".", ms=3.5)
        below.axhline(0.0, color="black", lw=0.6)
        below.set_title(
            f"nRMSE, %: drawn {d.nrmse_percent(d.time_constant_s):.2f}, "
            f"nearest {d.nrmse_percent(d.best_time_constant_s):.2f}, "
            f"high-fidelity {d.plants_nrmse_percent(d.likely_kPa):.2f}",
            loc="left",
            fontsize=8.0,
        )
        below.set_xlabel("time, s")
        for axis in (above, below):
            axis.set_xlim(0, 1.02 * time_s[-1])
    axes[0, 0].set_ylabel("reservoir, kPa gauge")
    axes[1, 0].set_ylabel("measured − model,\n% of P$_{r,0}$")
    return finish(figure, "Reservoir discharge (Eq. 3, the paper's Fig. 3)")


def _inflation(curves: Curves) -> Any:
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.9), layout="constrained")
    for s, likely, axis in zip(curves.steps, curves.likely_steps, axes, strict=True):
        target = s.condition.swing_kPa
        longest = min(1.25 * target / s.slower_kPa_per_s, STEP_TEST_S)

        def ramp(rate: float, target: float = target, longest: float = longest) -> Any:
            return [0.0, target / rate, longest], [0.0, target, target]

        axis.plot(*ramp(s.faster_kPa_per_s), color=BLUE, lw=1.6, ls="--", label="measured, if faster")
        axis.plot(*ramp(s.slower_kPa_per_s), color=BLUE, lw=1.6, ls=":", label="measured, if slower")
        axis.plot(*ramp(s.model_rate_kPa_per_s), **{**MODEL, "label": "paper's model (Eq. 4)"})
        shown = s.trace["time_s"] <= longest
        axis.plot(s.trace["time_s"][shown], s.trace["cv_reading_kPa"][shown], **PLANT)
        axis.plot(likely.trace["time_s"][shown], likely.trace["cv_reading_kPa"][shown], **LIKELY)
        axis.set_xlim(0, longest)
        axis.set_ylim(0, 1.12 * target)
        axis.set_xlabel("time, s")
        error = stated()[f"{s.condition.name}.rate_error"].value
        axis.set_title(
            f"{s.condition.name.upper()}: {s.condition.cv_volume_L:g} L on "
            f"{s.condition.reservoir_kPa:.0f} kPa\n"
            f"Eq. 4 {s.model_rate_kPa_per_s:.1f}, ours {s.rate_kPa_per_s:.1f} and "
            f"{likely.rate_kPa_per_s:.1f} kPa/s; paper ±{error:g} %",
            loc="left",
            fontsize=9.5,
        )
    axes[0].set_ylabel("control volume, kPa gauge")
    axes[-1].legend(frameon=False, fontsize=8, loc="lower right")
    return finish(figure, "Inflation speed (Eq. 4, the paper's Fig. 4)")


def _frequency(curves: Curves) -> Any:
    figure, axes = plt.subplots(1, 2, figsize=(11, 5.4), sharey=True, layout="constrained")
    tc4, tc5_low, tc5_full = curves.frequencies
    likely_tc4, likely_low, likely_full = curves.likely_frequencies
    for axis, responses, likely, baseline, n in (
        (axes[0], (tc4,), (likely_tc4,), curves.baselines[0], 1),
        (axes[1], (tc5_full, tc5_low), (likely_full, likely_low), curves.baselines[1], 2),
    ):
        first = responses[0]
        axis.axhline(math.sqrt(0.5), color=GREY, lw=0.8, ls=":")
        axis.text(19.5, math.sqrt(0.5) * 1.02, "−3 dB", ha="right", color=GREY, fontsize=8)
        axis.errorbar(
            baseline.x,
            baseline.y,
            yerr=baseline.std,
            color=GREY,
            ls="none",
            marker="s",
            ms=3,
            mfc="white",
            elinewidth=0.8,
            capsize=1.5,
            label=f"off-the-shelf regulator (baseline {n})",
        )
        line = curve(f"frequency_model_{first.condition.name}")
        off = _off(first, first.model_gain)
        axis.plot(line.x, line.y, **{**MODEL, "label": f"paper's model: {off}"})
        for f, style in zip(responses, ("-", "--"), strict=False):
            _plot_plant(axis, f, {**PLANT, "ls": style}, several=len(responses) > 1)
        for f, style in zip(likely, ("-", "--"), strict=False):
            _plot_plant(axis, f, {**LIKELY, "ls": style}, several=len(likely) > 1)
        axis.plot(first.measured.x, first.measured.y, **MEASURED)
        _log_axes(axis)
        axis.set_xlim(0.045, 20)
        axis.set_ylim(0.018, 1.4)
        axis.set_xlabel("command frequency, Hz")
        axis.legend(frameon=False, fontsize=8.5, loc="lower left")
        c = first.condition
        axis.set_title(
            f"{c.name.upper()}: {c.swing_kPa:.0f} kPa peak to peak, {c.cv_volume_L:g} L "
            "(rms: off the measured points)",
            loc="left",
            fontsize=10,
        )
    axes[0].set_ylabel("gain")
    return finish(figure, "Closed-loop frequency response (Eq. 6 and 7, the paper's Fig. 5)")


def _log_axes(axis: Any) -> None:
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xticks([0.1, 1, 10], ["0.1", "1", "10"])
    axis.set_yticks([0.02, 0.05, 0.1, 0.2, 0.5, 1.0], ["0.02", "0.05", "0.1", "0.2", "0.5", "1"])
    axis.set_yticks([], minor=True)


def _plot_plant(axis: Any, f: FrequencyResponse, style: dict[str, Any], several: bool) -> None:
    order = np.argsort(f.measured.x)
    supply = f" on {f.supply_kPa:.0f} kPa" if several else ""
    which = "high-fidelity" if style["color"] == PURPLE else "baseline"
    label = f"{which}{supply}: {_off(f, f.plant_gain)}"
    axis.plot(f.measured.x[order], f.plant_gain[order], **{**style, "label": label})


def _off(f: FrequencyResponse, gains: Array) -> str:
    return f"{f.rms_dB(gains):.1f} dB rms, {f.rms_dB(gains, BAND):.1f} up to {BAND:g} cut-offs"


def _sine(curves: Curves) -> Any:
    figure, (wave, bars) = plt.subplots(
        1, 2, figsize=(11, 4.2), width_ratios=[2.6, 1.0], layout="constrained"
    )
    full, low = curves.sines
    time_s = full.trace["time_s"] - full.trace["time_s"][0]
    shown = time_s <= 2.5
    wave.plot(time_s[shown], full.trace["target_kPa"][shown], color=ORANGE, lw=1.6, label="command, 1.2 Hz")
    for series, color, which in (
        (curves.sines, GREEN, "baseline"),
        (curves.likely_sines, PURPLE, "high-fidelity"),
    ):
        for s, style in zip(series, ("-", "--"), strict=True):
            wave.plot(
                time_s[shown],
                s.trace["cv_reading_kPa"][shown],
                color=color,
                ls=style,
                lw=1.3,
                label=f"{which}, {s.supply_kPa:.0f} kPa",
            )
    wave.set_xlabel("time, s")
    wave.set_ylabel("control volume, kPa gauge")
    wave.set_xlim(0, 2.5)
    wave.set_ylim(-1, 44)
    wave.legend(frameon=False, ncols=3, loc="upper left", fontsize=9)

    names = ("phlosar", "low_supply")
    places = np.arange(2)
    for shift, values, color, label in (
        (-0.27, [stated()[f"sine.{n}"].value for n in names], BLUE, "paper, measured"),
        (0.0, [s.peak_to_peak_kPa for s in curves.sines], GREEN, "baseline plant"),
        (0.27, [s.peak_to_peak_kPa for s in curves.likely_sines], PURPLE, "high-fidelity plant"),
    ):
        found = bars.bar(places + shift, values, 0.25, color=color, label=label)
        bars.bar_label(found, fmt="%.0f", fontsize=8.5)
    bars.set_xticks(places, [f"{full.supply_kPa:.0f} kPa", f'"low P$_r$"\n(ours {low.supply_kPa:.0f} kPa)'])
    bars.set_ylabel("peak to peak, kPa")
    bars.set_ylim(0, 46)
    bars.legend(frameon=False, fontsize=8, loc="upper right")
    return finish(figure, "A 1.2 Hz command, 34 kPa peak to peak (the paper's Fig. 6)")


def _cycles(curves: Curves) -> Any:
    figure, axis = plt.subplots(figsize=(8.5, 5.0), layout="constrained")
    c = curves.cycles
    full_kPa = float(c.reservoir_kPa[-1])
    axis.axhline(stated()["cycles.least"].value, color=GREY, lw=0.8, ls=":")
    axis.text(5, stated()["cycles.least"].value + 6, "the paper: more than 300", color=GREY, fontsize=8.5)
    for x, y, color, style, label, lift in (
        (c.plant_kPa, c.plant_cycles, GREEN, "o-", "ours (baseline plant, rigid, vents by itself)", 0),
        (c.reservoir_kPa, c.rigid, ORANGE, "-", "Eq. 8, rate of a triangle", 9),
        (c.reservoir_kPa, c.rigid_sine, ORANGE, "--", "Eq. 8, greatest rate of a sine", -9),
        (c.reservoir_kPa, c.pouch, PURPLE, "-", "Eq. 8 with the air of a flat pouch", 0),
    ):
        axis.plot(x, y, style, color=color, lw=1.8, ms=4, label=label)
        axis.text(full_kPa + 8, y[-1] + lift, f"{y[-1]:.1f}", color=color, va="center", fontweight="bold")
    axis.set_xlim(0, full_kPa + 50)
    axis.set_ylim(0, 680)
    axis.set_xlabel("reservoir, kPa gauge")
    axis.set_ylabel("cycles left")
    axis.legend(frameon=False, loc="upper left")
    axis.set_title("0.1 L to 20.7 kPa at 0.55 Hz from a 2 L bottle", loc="left", fontsize=10)
    return finish(figure, "Cycles (Eq. 8, the paper's demonstration)")


# The diagnosis.


def draw_diagnosis(diagnosis: PaperDiagnosis, folder: Path) -> list[Path]:
    """Draw two PNGs into an existing folder. Returns their paths."""
    plots = {
        "discharge": _diagnosed_discharges(diagnosis.discharges),
        "frequency": _diagnosed_responses(diagnosis.responses),
    }
    return save(plots, folder, "paper-diagnosis")


def _diagnosed_discharges(found: Discharges) -> Any:
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


def _diagnosed_responses(responses: Responses) -> Any:
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
        _log_axes(above)
        below.axhline(0.0, color="black", lw=0.6)
        below.set_xlabel("command frequency, Hz")
        for axis in (above, below):
            axis.axvline(BAND * stated()[f"{test}.cutoff_drawn"].value, color=GREY, lw=0.8, ls=":")
    axes[0, 0].set_ylabel("gain")
    axes[1, 0].set_ylabel("measured over simulated, dB")
    axes[0, 0].legend(frameon=False, fontsize=9)
    return finish(figure, "The paper's frequency responses (dotted: three cut-offs of its model)")
