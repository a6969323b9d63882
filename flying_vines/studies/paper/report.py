"""The comparison on a terminal, and as plain data."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from flying_vines.studies.paper.compare import SINE_VOLUME_L
from flying_vines.studies.paper.rows import PaperComparison, PaperRow

STYLES = {"agrees": "green", "differs": "red", "undecided": "yellow"}
ROW_KEYS = (
    "key", "quantity", "unit", "paper", "paper_to", "bound", "ours", "relative_difference", "by", "verdict",
    "place", "note",
)  # fmt: skip
"""Keys of a row in JSON, in this order."""


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
        item(console, f"{number}.", finding)
    console.print("\nWhy a row differs or cannot be decided", style="bold")
    for note, quantities in reasons(rows).items():
        item(console, "·", f"{'; '.join(quantities)}: {note}")


def reasons(rows: tuple[PaperRow, ...]) -> dict[str, list[str]]:
    """For each note, the quantities that differ or cannot be decided for this reason."""
    found: dict[str, list[str]] = {}
    for row in rows:
        if row.verdict != "agrees":
            found.setdefault(row.note, []).append(row.quantity)
    return found


def item(console: Console, mark: str, text: str) -> None:
    """Print a text with a hanging mark."""
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


def as_json(comparison: PaperComparison) -> dict[str, Any]:
    """The comparison as plain lists, numbers and texts; the keys are described in docs/paper.md."""
    c = comparison.curves
    return {
        "rows": [{key: getattr(row, key) for key in ROW_KEYS} for row in comparison.rows],
        "findings": list(comparison.findings),
        "discharge": [
            {
                "name": d.name,
                "reservoir_volume_L": d.reservoir_volume_L,
                "time_s": _plain(d.measured.x),
                "measured_kPa": _plain(d.measured.y),
                "time_constant_s": d.time_constant_s,
                "best_time_constant_s": d.best_time_constant_s,
                "flow_resistance_kPa_s_per_SL": d.flow_resistance_kPa_s_per_SL,
                "plant_kPa": _plain(d.at_points(d.plant_kPa)),
                "likely_kPa": _plain(d.at_points(d.likely_kPa)),
            }
            for d in c.discharges
        ],
        "inflation": [
            {
                "name": s.condition.name,
                "swing_kPa": s.condition.swing_kPa,
                "cv_volume_L": s.condition.cv_volume_L,
                "reservoir_kPa": s.condition.reservoir_kPa,
                "time_s": _plain(s.trace["time_s"][::20]),
                "plant_kPa": _plain(s.trace["cv_reading_kPa"][::20]),
                "likely_kPa": _plain(likely.trace["cv_reading_kPa"][::20]),
                "plant_rate_kPa_per_s": s.rate_kPa_per_s,
                "likely_rate_kPa_per_s": likely.rate_kPa_per_s,
                "model_rate_kPa_per_s": s.model_rate_kPa_per_s,
            }
            for s, likely in zip(c.steps, c.likely_steps, strict=True)
        ],
        "frequency": [
            {
                "name": f.condition.name,
                "supply_kPa": f.supply_kPa,
                "frequency_Hz": _plain(f.measured.x),
                "measured_gain": _plain(f.measured.y),
                "model_gain": _plain(f.model_gain),
                "plant_gain": _plain(f.plant_gain),
                "likely_gain": _plain(likely.plant_gain),
            }
            for f, likely in zip(c.frequencies, c.likely_frequencies, strict=True)
        ],
        "sine": [
            {
                "supply_kPa": s.supply_kPa,
                "cv_volume_L": SINE_VOLUME_L,
                "time_s": _plain((s.trace["time_s"] - s.trace["time_s"][0])[::10]),
                "command_kPa": _plain(s.trace["target_kPa"][::10]),
                "plant_kPa": _plain(s.trace["cv_reading_kPa"][::10]),
                "likely_kPa": _plain(likely.trace["cv_reading_kPa"][::10]),
            }
            for s, likely in zip(c.sines, c.likely_sines, strict=True)
        ],
        "cycles": {
            "reservoir_kPa": _plain(c.cycles.reservoir_kPa),
            "rigid": _plain(c.cycles.rigid),
            "rigid_sine": _plain(c.cycles.rigid_sine),
            "pouch": _plain(c.cycles.pouch),
            "plant_reservoir_kPa": _plain(c.cycles.plant_kPa),
            "plant_cost_kPa": _plain(c.cycles.plant_cost_kPa),
            "plant": _plain(c.cycles.plant_cycles),
        },
    }


def _plain(values: NDArray[np.float64]) -> list[float]:
    return [float(f"{value:.7g}") for value in values]
