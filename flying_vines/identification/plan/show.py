"""Prints a plan on a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

from rich.console import Console
from rich.table import Table
from rich.text import Text

from flying_vines.identification.plan.cause_distance import SETTLED
from flying_vines.identification.plan.planning import CausePair, PlannedRun, Recording, RecordingPlan
from flying_vines.identification.recording import counted
from flying_vines.identification.verdict import NONE

_NAMED = 2
_WORST = 8


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
    table = Table(box=None, padding=(0, 2, 0, 0))
    table.add_column("run")
    table.add_column("reservoir,\nkPa gauge", justify="right")
    table.add_column("s", justify="right")
    table.add_column("air,\nSL", justify="right")
    mixed = len({run.commanded for run in recording.runs}) > 1
    if mixed:
        table.add_column("by")
    table.add_column("purpose", overflow="fold")
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
    table = Table(box=None, padding=(0, 2, 0, 0), title="Lowest separation", title_justify="left")
    table.add_column("in the rig")
    table.add_column("fitted")
    table.add_column("σ", justify="right")
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
