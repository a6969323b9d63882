"""The guess of an import, as a table and as a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from flying_vines.identification.importing.columns import IGNORED
from flying_vines.identification.importing.runs import Proposal
from flying_vines.identification.importing.units import parse_unit

_SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", " ": "blanks", "|": "bars"}


def show(proposal: Proposal, console: Console) -> None:
    """Print how a file is read: layout, columns, runs, and notes."""
    text, table = proposal.table.layout, Table(box=None, pad_edge=False, header_style="bold")
    header = f"header in line {text.header_line}" if text.header_line else "no header"
    rows = len(proposal.table.cells[0])
    console.print(f"{proposal.path.name}  {rows} rows, {_SEPARATORS[text.separator]}, "
                  f"decimal “{text.decimal}”, {text.encoding}, {header}", highlight=False)  # fmt: skip
    for title in ("column", "meaning", "unit", "factor", "first values, converted", "why"):
        table.add_column(title, overflow="fold", no_wrap=title == "meaning")
    for column in proposal.answers.columns:
        unit = parse_unit(column.unit) if column.unit else None
        values = proposal.table.numbers(column.number - 1)[:3]
        if unit:
            values = values * unit.factor + unit.offset
        first = ", ".join(f"{value:.5g}" for value in values.tolist())
        factor = f"{unit.factor:.5g}" + (f" {unit.offset:+.6g}" if unit.offset else "") if unit else ""
        name = f"{column.number} {column.name}"
        style = "dim" if column.meaning == IGNORED else ""
        table.add_row(name, column.meaning, column.unit, factor, first, column.why, style=style)
    console.print(table, highlight=False, markup=False)
    for name, run in proposal.runs.items():
        console.print(f"Run   {name}: {len(run['time'])} rows, {np.ptp(run['time']):.4g} s", highlight=False)
    for note in proposal.notes:
        console.print(f"Note  {note}", highlight=False, markup=False)
    for question in proposal.questions:
        if question.guess:
            console.print(
                f"Guess {question.key} = {question.guess}: {question.text}", highlight=False, markup=False
            )


def draw(proposal: Proposal, folder: Path) -> Path:
    """Draw pressures and valve signals of all runs, converted. Returns the path. Needs matplotlib."""
    from matplotlib import pyplot as plt

    from flying_vines.plots.style import BLUE, GREEN, GREY, ORANGE, PURPLE, finish, save

    figure, axes = plt.subplots(2, 1, figsize=(8, 5), sharex=True, layout="constrained", height_ratios=(2, 1))
    kinds = (
        (0, {"reservoir_pressure": ORANGE, "cv_pressure": BLUE, "command_kPa": GREY}, "kPa gauge"),
        (1, {"evp_opening": BLUE, "dvp_opening": PURPLE, "solenoid": GREEN}, "opening, 0…1"),
    )
    for row, colours, unit in kinds:
        axes[row].set_ylabel(unit)
        style = "steps-post" if row else "default"  # a command holds until the next one
        for run in proposal.runs.values():
            for meaning, colour in colours.items():
                if meaning in run and (row == 0 or np.any(run[meaning])):
                    axes[row].plot(
                        run["time"],
                        run[meaning],
                        color=colour,
                        lw=1,
                        label=meaning.removesuffix("_kPa"),
                        drawstyle=style,
                    )
        handles = dict(zip(*reversed(axes[row].get_legend_handles_labels()), strict=True))
        if handles:
            axes[row].legend(handles.values(), handles.keys(), fontsize=8)
        elif row:
            axes[row].set_title("no valve ever opens", fontsize=9, loc="left")
    axes[1].set_ylim(-0.05, 1.05)
    axes[1].set_xlabel("time, s")
    finish(figure, f"{proposal.path.name} as it is imported")
    return save({"import": figure}, folder, proposal.path.stem)[0]
