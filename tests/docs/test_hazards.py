"""Every hazard has a cause, a measure against it, and a test that exists."""

from __future__ import annotations

import ast
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
from rules_taken_away import MODULES, rules_of

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "hazards.md").read_text(encoding="utf-8")
TITLES = "| cause | what prevents it | test |"
BY_HAND = re.compile(r"by hand: \[[a-z ]+\]\((?:wiring|first-flash)\.md#[a-z-]+\)")
TEST = re.compile(r"`(tests/[\w/]+\.py)::(test_\w+)`")
ROWS = [
    [cell.strip() for cell in line.strip("| ").split(" | ")]
    for line in PAGE.splitlines()
    if line.startswith("| ") and line != TITLES and not line.startswith("| ---")
]


@cache
def functions(path: str) -> frozenset[str]:
    """The names of the tests in a file."""
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    return frozenset(
        node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    )


def test_each_hazard_has_its_table() -> None:
    hazards = re.split(r"^## ", PAGE, flags=re.MULTILINE)[1:]
    assert len(hazards) >= 8
    for hazard in hazards:
        _, table = hazard.split(TITLES)
        assert table.strip().count("\n") >= 1


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0][:60])
def test_each_row_has_a_test_that_exists(row: list[str]) -> None:
    cause, prevents, proof = row
    assert cause and prevents
    if BY_HAND.fullmatch(proof):
        return
    found = TEST.findall(proof)
    assert found and TEST.sub("", proof).strip(" ,") == ""
    for path, name in found:
        assert name in functions(path), f"{path} has no {name}"


def test_the_rules_that_are_taken_away_are_all_found() -> None:
    assert sum(len(rules_of(module)) for module in MODULES) > 300
    for lost in (replace(MODULES[0], functions=("watch", "gone")), replace(MODULES[0], tables=("_GONE",))):
        with pytest.raises(LookupError, match=r"core/safety\.py has no (gone|_GONE)$"):
            rules_of(lost)
