"""Every row of the catalogue names a test that exists."""

from __future__ import annotations

import re
from pathlib import Path

from .catalogue import ROWS, SECTIONS
from .injections import INJECTIONS

TESTS = Path(__file__).parents[1]
PROOFS = set(
    re.findall(
        r"def (test_\w+)",
        "\n".join(path.read_text(encoding="utf-8") for path in TESTS.rglob("test_*.py")),
    )
)
AT_LEAST = 30


def test_every_row_has_its_proof() -> None:
    assert sum(len(rows) for rows in SECTIONS.values()) == len(ROWS) >= AT_LEAST
    flown = {row.id for row in ROWS.values() if row.proof == "test_a_fault_in_flight"}
    assert flown <= set(INJECTIONS) <= set(ROWS)
    assert {row.proof for row in ROWS.values()} <= PROOFS
