"""The vine's bend in a terminal, in braille and in ASCII."""

from __future__ import annotations

import math

import pytest

from flying_vines.terminal.vine_sketch import COLUMNS, LINES, sketch


def tip_column(lines: list[str]) -> float:
    """Mean column of the characters in the lowest line that has any."""
    last = next(line for line in reversed(lines) if line.strip())
    inked = [i for i, c in enumerate(last) if c != " "]
    return sum(inked) / len(inked)


@pytest.mark.parametrize("unicode", [True, False])
def test_a_larger_angle_moves_the_tip_to_the_right_and_up(unicode: bool) -> None:
    straight, half, full = (sketch(deg, unicode) for deg in (0.0, 45.0, 90.0))
    assert tip_column(straight) < tip_column(half) < tip_column(full)
    assert sum(bool(line.strip()) for line in straight) > sum(bool(line.strip()) for line in full)


@pytest.mark.parametrize("unicode", [True, False])
@pytest.mark.parametrize("angle_deg", [-300.0, -60.0, 0.0, 33.0, 180.0, 1000.0, math.nan])
def test_every_angle_fits_the_sketch(angle_deg: float, unicode: bool) -> None:
    lines = sketch(angle_deg, unicode)
    assert [len(line) for line in lines] == [COLUMNS] * LINES
    ink = set("".join(lines)) - {" "}
    assert all("⠀" < c <= "⣿" for c in ink) if unicode else ink == {"#"}


def test_with_an_unknown_angle_only_the_drone_is_drawn() -> None:
    assert [line.strip() for line in sketch(math.nan)[2:]] == [""] * (LINES - 2)
