"""Draws runs: setpoints, sensor readings, valve openings (EVP: inflation, DVP: Venturi supply)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt

from flying_vines.plots.style import BLUE, GREEN, GREY, ORANGE, RED, plain
from flying_vines.simulation.scenario.run import ScenarioRun

_MAX_ACROSS = 2
_MIN_SPAN_KPA = 40.0


def draw_runs(runs: Sequence[ScenarioRun], path: Path, title: str) -> None:
    """Draw all runs into one PNG: pressures, openings and reservoir over time."""
    across = min(_MAX_ACROSS, len(runs))
    down = -(-len(runs) // across)
    figure = plt.figure(
        figsize=(6.4 * across + (3.0 if across == 1 else 0.0), 0.4 + 4.6 * down), layout="constrained"
    )
    figure.suptitle(title, x=0.01, ha="left", fontweight="bold")
    blocks = figure.subfigures(down, across, squeeze=False).flat
    for number, (run, block) in enumerate(zip(runs, blocks, strict=False), start=1):
        _draw(run, block, f"{number}  {run.label}")
    # Without the software's name and version, equal runs give equal bytes.
    figure.savefig(path, dpi=110, metadata={"Software": None})
    plt.close(figure)


def _draw(run: ScenarioRun, block: Any, label: str) -> None:
    has_cv = not np.isnan(run.cv_pressure_kPa[0])
    has_reservoir = not np.isnan(run.reservoir_pressure_kPa[0])
    panels: list[tuple[Callable[[ScenarioRun, Any], None], float]] = [(_openings, 1.0)]
    if has_cv:
        panels.insert(0, (_pressure, 2.6))
    if has_reservoir:
        panels.append((_reservoir, 1.2 if has_cv else 2.6))
    axes = block.subplots(len(panels), 1, sharex=True, height_ratios=[height for _, height in panels])
    for (draw, _), axis in zip(panels, axes, strict=True):
        draw(run, axis)
    axes[-1].set_xlabel("time, s")
    if run.faults:
        label += f"  (the firmware vented: {run.faults})"
    axes[0].set_title(label, loc="left", fontsize=10, color=RED if run.faults else "black")
    for axis in axes:
        plain(axis)
        axis.set_xlim(run.time_s[0], max(run.time_s[-1], run.time_s[0] + 1e-3))
    block.align_ylabels()


def _pressure(run: ScenarioRun, axis: Any) -> None:
    axis.margins(y=0.18)
    if not np.isnan(run.command_kPa).all():
        axis.step(run.time_s, run.command_kPa, color=ORANGE, lw=1.1, where="post", label="command")
    axis.plot(run.time_s, run.cv_pressure_kPa, color=BLUE, lw=0.9, label="control volume")
    axis.legend(loc="upper right", ncols=2, frameon=False, fontsize=8)
    axis.set_ylabel("kPa gauge")


def _openings(run: ScenarioRun, axis: Any) -> None:
    axis.fill_between(run.time_s, run.evp_opening, color=BLUE, alpha=0.6, lw=0.5, step="post")
    axis.fill_between(run.time_s, -run.dvp_opening, color=GREEN, alpha=0.7, lw=0.5, step="post")
    axis.fill_between(run.time_s, -1.4, -1.15, where=run.solenoid, color=GREY, lw=0.5, step="post")
    axis.set_ylim(-1.5, 1.1)
    axis.set_yticks([-1.28, -0.5, 0.5], ["solenoid", "DVP", "EVP"], fontsize=8)


def _reservoir(run: ScenarioRun, axis: Any) -> None:
    axis.plot(run.time_s, run.reservoir_pressure_kPa, color=BLUE, lw=1.0)
    middle_kPa = (run.reservoir_pressure_kPa.min() + run.reservoir_pressure_kPa.max()) / 2.0
    # A minimum range of the axis, so that noise does not look like a change of pressure.
    axis.update_datalim([(0.0, middle_kPa - _MIN_SPAN_KPA / 2.0), (0.0, middle_kPa + _MIN_SPAN_KPA / 2.0)])
    axis.autoscale_view(scalex=False)
    axis.set_ylabel("reservoir,\nkPa gauge")
