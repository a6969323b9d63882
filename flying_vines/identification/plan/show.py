"""A plan on a terminal, as a figure, and as files: a scenario for the simulator, profiles for the service."""

from __future__ import annotations

import json
from collections.abc import Sequence
from math import sqrt
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from flying_vines.identification.plan import CausePair, PlannedRun, Recording, RecordingPlan
from flying_vines.identification.plan.choose import SETTLED
from flying_vines.identification.recording import counted
from flying_vines.identification.verdict import NONE
from flying_vines.plots.style import BLUE, RED, finish
from flying_vines.simulation.scenario.scenario import ProfileRun

_NAMED = 2
_WORST = 8
_MAX_SIGMAS = 1000.0
_DARK = 30.0
"""From this number of standard deviations on, a cell is dark and its number is white."""
SCENARIO, PROFILES = "scenario.toml", "profiles.toml"
_FIRST_NUMBER = 101
_HEADER = """\
# Append this to the service's configuration, and check it: flying-vines config check FILE
# For each run: vent the vine, bring the reservoir to the pressure in the run's comment, and wait 2 s. Start
# the run with the command USER_1 and its number as param1. After the run vent, and wait 6 s.
"""


def show(plan: RecordingPlan, console: Console) -> None:
    """Print the runs with their purpose, the pairs with the lowest separation, and the open pairs."""
    best = plan.best
    time = f"{best.seconds:.0f} of {60.0 * plan.minutes:.0f} s"
    air = f"{best.air_SL:.2f} of {plan.air_SL:.2f} standard litres of air"
    console.print(Text(f"{counted(len(best.runs), 'run')}, {time}, {air}", style="bold"))
    console.print(_runs(best))
    console.print()
    console.print(_worst(plan))
    console.print()
    for line in _left(plan):
        console.print(Text(line))


def in_words(pairs: Sequence[CausePair]) -> str:
    """Open pairs as text: `a / b; c does not show`."""
    hidden = [pair.first for pair in pairs if pair.second == NONE]
    texts = [f"{a} / {b}" for a, b in pairs if b != NONE]
    if hidden:
        texts.append(f"{', '.join(hidden)} {'do' if len(hidden) > 1 else 'does'} not show")
    return "; ".join(texts)


def _runs(recording: Recording) -> Table:
    mixed = len({run.commanded for run in recording.runs}) > 1
    table = Table(
        "run",
        *(Column(heading, justify="right") for heading in ("reservoir,\nkPa gauge", "s", "air,\nSL")),
        *(("by",) if mixed else ()),
        Column("purpose", overflow="fold"),
        box=None,
        padding=(0, 2, 0, 0),
    )
    for run in recording.runs:
        table.add_row(
            run.name,
            f"{run.kind.reservoir_kPa:.0f}",
            f"{run.seconds:.1f}",
            f"{run.air_SL:.2f}",
            *(("commands" if run.commanded else "openings",) if mixed else ()),
            f"{run.shows}; {_why(run)}",
        )
    return table


def _why(run: PlannedRun) -> str:
    found = run.separations
    texts = [f"{s.pair.first} / {s.pair.second} {s.without:.0f} → {s.with_all:.0f} σ" for s in found[:_NAMED]]
    if len(found) > _NAMED:
        texts.append(f"{len(found) - _NAMED} more")
    return ", ".join(texts)


def _worst(plan: RecordingPlan) -> Table:
    """The pairs with the lowest separation, without causes that do not show."""
    columns = "in the rig", "fitted", Column("σ", justify="right")
    table = Table(*columns, box=None, padding=(0, 2, 0, 0), title="Lowest separation", title_justify="left")
    fitted = (*plan.names, NONE)
    cells = [
        (float(plan.matrix[row, column]), name, fitted[column])
        for row, name in enumerate(plan.names)
        for column in range(len(fitted))
        if row != column and plan.matrix[row, -1] >= SETTLED
    ]
    for value, there, other in sorted(cells)[:_WORST]:
        table.add_row(there, other, f"{sqrt(value):.1f}", style="" if value >= SETTLED else "red")
    return table


def _left(plan: RecordingPlan) -> list[str]:
    if not plan.best.open:
        lines = ["Every cause is separated from every other cause, and from the baseline."]
    else:
        sooner = [pair for pair in plan.best.open if pair not in plan.never]
        lines = [f"Not separated; more time or air would help: {in_words(sooner)}."] if sooner else []
        if plan.never:
            lines.append(f"Not separated by any run of the library: {in_words(plan.never)}.")
    if any(not run.commanded for run in plan.best.runs):
        if plan.by_commands.runs:
            runs, seconds = counted(len(plan.by_commands.runs), "run"), plan.by_commands.seconds
            left = in_words(plan.by_commands.open)
            lines.append(f"The service alone can do {runs}, {seconds:.0f} s; not separated then: {left}.")
        else:
            lines.append("The service alone cannot do any of these runs.")
    return lines


def figures(plan: RecordingPlan) -> dict[str, Any]:
    """By name: `matrix`, the separation of each cause in the rig from each fitted cause."""
    sigmas = plan.sigmas.copy()
    np.fill_diagonal(sigmas, np.nan)
    lowest = sqrt(SETTLED)
    figure, axis = plt.subplots(figsize=(11.0, 9.0), layout="constrained")
    shades = LinearSegmentedColormap.from_list("settled", ["#eef3fa", BLUE, "#0f2a4d"])
    colours = shades.with_extremes(under=RED)
    style: dict[str, Any] = {"cmap": colours, "norm": LogNorm(lowest, _MAX_SIGMAS), "aspect": "auto"}
    image = axis.imshow(np.maximum(sigmas, 1e-3), interpolation="none", **style)
    for (row, column), value in np.ndenumerate(sigmas):
        if np.isfinite(value):
            colour = "white" if value > _DARK or value < lowest else "black"
            text = f"{value:.0f}" if value < 999.5 else f"{value / 1000.0:.0f}k"
            axis.text(column, row, text, ha="center", va="center", fontsize=7, color=colour)
    fitted = [*plan.names, NONE]
    axis.set_xticks(range(len(fitted)), fitted, rotation=55, ha="right", rotation_mode="anchor", fontsize=8)
    axis.set_yticks(range(len(plan.names)), plan.names, fontsize=8)
    axis.set_xlabel("fitted")
    axis.set_ylabel("cause in the rig, at its typical strength")
    bar = figure.colorbar(image, ax=axis, extend="min", pad=0.01)
    bar.set_label(f"standard deviations; red: not separated, below {lowest:g}")
    seconds, air_SL = plan.best.seconds, plan.best.air_SL
    title = f"Separation by {len(plan.best.runs)} runs: {seconds:.0f} s, {air_SL:.1f} standard litres of air"
    finished = finish(figure, title)
    axis.grid(False)
    return {"matrix": finished}


def write_plan(plan: RecordingPlan, folder: Path) -> list[Path]:
    """Write the best runs as a scenario, and those that the service can do as profiles. Returns the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    texts = {SCENARIO: scenario_text(plan.best)}
    if plan.by_commands.runs:
        texts[PROFILES] = profiles_text(plan.by_commands)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    return [folder / name for name in texts]


def scenario_text(recording: Recording) -> str:
    """A scenario file."""
    lines = [f"name = {_value(recording.scenario.name)}"]
    for run in recording.runs:
        lines += ["", f"# {run.shows}", "[[runs]]", *_lines(msgspec.to_builtins(run.kind))]
    return "\n".join([*lines, ""])


def profiles_text(recording: Recording) -> str:
    """Profiles of the service's configuration, and the commands that start them."""
    lines = [_HEADER.rstrip()]
    for number, run in enumerate(recording.runs, start=_FIRST_NUMBER):
        name = f"plan-{number}-{run.name.replace('_', '-')}"
        lines += ["", f"# {run.shows}; {run.seconds:.0f} s, reservoir at {run.kind.reservoir_kPa:g} kPa"]
        lines += ["[[items]]", 'command = "user_1"', f"match = {{ param1 = {number} }}"]
        lines += [f"profile = {_value(name)}", "", f"[profiles.{name}]", *_segments(run)]
    return "\n".join([*lines, ""])


def _segments(run: PlannedRun) -> list[str]:
    assert isinstance(run.kind, ProfileRun)
    segments = list(msgspec.to_builtins(run.kind.segments))
    if segments[-2:-1] != (end := [{"kind": "step", "to_kPa": 0.0}]):
        segments += end
    return _lines({"segments": segments, "rate_kPa_per_s": run.kind.rate_kPa_per_s})


def _lines(table: dict[str, Any]) -> list[str]:
    return [f"{key} = {_value(value)}" for key, value in table.items() if value is not None]


def _value(value: Any) -> str:
    """A value as TOML: each item of a list on its own line, and the point of a float is kept."""
    if isinstance(value, dict):
        return f"{{ {', '.join(_lines(value))} }}"
    if isinstance(value, list | tuple):
        return "\n".join(["[", *(f"    {_value(item)}," for item in value), "]"])
    return json.dumps(value)
