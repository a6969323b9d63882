"""The page on faults says what the catalogue says, and every row of the catalogue has its proof."""

from __future__ import annotations

import re
from pathlib import Path

from .catalogue import ROWS, SECTIONS, Row
from .injections import INJECTIONS

TESTS = Path(__file__).parents[1]
PAGE = (TESTS.parent / "docs" / "faults.md").read_text(encoding="utf-8")
PROOFS = set(
    re.findall(
        r"def (test_\w+)",
        "\n".join(path.read_text(encoding="utf-8") for path in TESTS.rglob("test_*.py")),
    )
)
AT_LEAST = 30


def table(rows: tuple[Row, ...]) -> list[str]:
    """A section's rows in Markdown."""
    lines = [
        "| fault | seen by | safe within, ms | measured, ms | safe state | the pilot reads | cleared by |",
        "| --- | --- | ---: | ---: | --- | --- | --- |",
    ]
    for row in rows:
        told = f"“{row.told}”" if row.told else "–"
        state = row.safe_state
        if row.left_kPa:
            state += f" ({row.left_kPa:g} kPa)"
        if row.highest_kPa is not None:
            state += f"; **up to {row.highest_kPa:g} kPa before**"
        numbers = (str(ms) if ms is not None else "–" for ms in (row.allowed_ms, row.measured_ms))
        cells = (row.fault, row.seen_by, *numbers, state, told, row.cleared.value)
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def test_the_tables_are_the_catalogue_s() -> None:
    for title, rows in SECTIONS.items():
        assert "\n".join([f"## {title}", "", *table(rows)]) in PAGE, f"{title}: " + "\n".join(table(rows))


def test_every_row_has_its_proof() -> None:
    assert sum(len(rows) for rows in SECTIONS.values()) == len(ROWS) >= AT_LEAST
    flown = {row.id for row in ROWS.values() if row.proof == "test_a_fault_in_flight"}
    assert flown <= set(INJECTIONS) <= set(ROWS)
    assert {row.proof for row in ROWS.values()} <= PROOFS
