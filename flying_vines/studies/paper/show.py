"""The comparison on a terminal."""

from __future__ import annotations

from collections import Counter

from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from flying_vines.studies.paper.rows import PaperRow

STYLES = {"agrees": "green", "differs": "red", "undecided": "yellow"}


def show(rows: tuple[PaperRow, ...], findings: tuple[str, ...], console: Console) -> None:
    """Print the table, the contradictions within the paper, and the reasons why rows do not agree."""
    console.print(_table(rows))
    counts = Counter(row.verdict for row in rows)
    console.print(
        f"{counts['agrees']} agree, {counts['differs']} differ, {counts['undecided']} cannot be decided. "
        "Ours is (e) the paper's equation, (d) its printed data, (p) the baseline plant and (h) the "
        "high-fidelity plant in closed loop, (t) the paper's text."
    )
    console.print("\nWhat disagrees in the paper itself", style="bold")
    for number, finding in enumerate(findings, 1):
        _item(console, f"{number}.", finding)
    console.print("\nWhy a row differs or cannot be decided", style="bold")
    for note, quantities in reasons(rows).items():
        _item(console, "·", f"{'; '.join(quantities)}: {note}")


def reasons(rows: tuple[PaperRow, ...]) -> dict[str, list[str]]:
    """For each note, the quantities that differ or cannot be decided for this reason."""
    found: dict[str, list[str]] = {}
    for row in rows:
        if row.verdict != "agrees":
            found.setdefault(row.note, []).append(row.quantity)
    return found


def _item(console: Console, mark: str, text: str) -> None:
    item = Table.grid(padding=(0, 1))
    item.add_row(mark, Text(text))
    console.print(Padding(item, (0, 0, 0, 1)))


def _table(rows: tuple[PaperRow, ...]) -> Table:
    table = Table(box=None, padding=(0, 1), pad_edge=False)
    table.add_column("quantity", overflow="fold")
    for heading in ("unit", "paper", "ours"):
        table.add_column(heading, justify="left" if heading == "unit" else "right", no_wrap=True)
    table.add_column("", no_wrap=True)
    table.add_column("off", justify="right", no_wrap=True)
    table.add_column("verdict", no_wrap=True)
    chapter = ""
    for row in rows:
        if row.key.split(".")[0] != chapter:
            if chapter:
                table.add_section()
            chapter = row.key.split(".")[0]
        off = row.relative_difference
        table.add_row(
            row.quantity,
            row.unit,
            row.bound
            + _number(row.paper, row)
            + (f"–{_number(row.paper_to, row)}" if row.paper_to is not None else ""),
            _number(row.ours, row),
            row.by[0],
            "" if off is None else f"{100.0 * off:+z.1f} %",
            Text(row.verdict, style=STYLES[row.verdict]),
        )
    return table


def _number(value: float | None, row: PaperRow) -> str:
    if value is None:
        return "–"
    # The paper's time constants have five digits.
    return f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.{5 if row.unit == 's' else 4}g}"
