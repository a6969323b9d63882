"""The vine's bend in a terminal, in braille and in ASCII."""

from __future__ import annotations

import math

import pytest

from flying_vines.terminal.vine_sketch import COLUMNS, LINES, sketch


def tip_column(lines: list[str]) -> float:
    """Where the lowest ink is, in characters from the left."""
    last = next(line for line in reversed(lines) if line.strip())
    inked = [i for i, c in enumerate(last) if c != " "]
    return sum(inked) / len(inked)


@pytest.mark.parametrize("unicode", [True, False])
def test_it_hangs_straight_and_bends_to_the_right(unicode: bool) -> None:
    straight, half, full = (sketch(deg, unicode) for deg in (0.0, 45.0, 90.0))
    assert tip_column(straight) < tip_column(half) < tip_column(full)
    assert sum(bool(line.strip()) for line in straight) > sum(bool(line.strip()) for line in full)


@pytest.mark.parametrize("unicode", [True, False])
@pytest.mark.parametrize("angle_deg", [-300.0, -60.0, 0.0, 33.0, 180.0, 1000.0, math.nan])
def test_every_bend_fits_its_lines(angle_deg: float, unicode: bool) -> None:
    lines = sketch(angle_deg, unicode)
    assert [len(line) for line in lines] == [COLUMNS] * LINES
    ink = set("".join(lines)) - {" "}
    assert all("⠀" < c <= "⣿" for c in ink) if unicode else ink == {"#"}


def test_a_bend_that_is_not_known_leaves_the_drone_alone() -> None:
    assert [line.strip() for line in sketch(math.nan)[2:]] == [""] * (LINES - 2)
