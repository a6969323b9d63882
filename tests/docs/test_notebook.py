"""The notebook of docs/ runs, and its stored output is up to date."""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Iterator
from typing import Any

import pytest

from docs import notebook
from flying_vines.physics import effects

NUMBER = re.compile(r"\d+(?:\.\d+)?(?:e-?\d+)?")


@pytest.fixture(autouse=True)
def same_catalogue() -> Iterator[None]:
    yield
    effects._added.clear()
    effects.catalogue.cache_clear()


def printed(found: dict[str, Any]) -> list[str]:
    """The output of each code cell."""
    return [
        "".join(line for output in cell["outputs"] for line in output.get("text", ()))
        for cell in notebook.code_cells(found)
    ]


def test_it_has_ten_cells_that_import_nothing_else_of_ours() -> None:
    cells = notebook.code_cells(notebook.read())
    assert len(cells) == 10 and [cell["execution_count"] for cell in cells] == list(range(1, 11))
    code = "".join(line for cell in cells for line in cell["source"])
    assert re.findall(r"^.*flying_vines.*$", code, re.MULTILINE) == ["from flying_vines import api"]
    pictures = [output for cell in cells for output in cell["outputs"] if "data" in output]
    assert len(pictures) == 3


@pytest.mark.long
def test_it_runs_and_prints_what_it_shows() -> None:
    shown = notebook.read()
    again = copy.deepcopy(shown)
    names = notebook.run(again)
    assert names["verdict"].cause == "porous_wall"  # type: ignore[attr-defined]
    for before, after in zip(printed(shown), printed(again), strict=True):
        assert NUMBER.sub("", after) == NUMBER.sub("", before)
        for old, new in zip(NUMBER.findall(before), NUMBER.findall(after), strict=True):
            assert math.isclose(float(old), float(new), rel_tol=0.05), (before, after)
