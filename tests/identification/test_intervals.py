"""The crossing of a likelihood profile with its limit, for any shape."""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flying_vines.identification.intervals import ABOVE, _crossing, _plateau_end

PROFILES: dict[str, tuple[Callable[[float], float], float]] = {
    "a parabola": (lambda d: (d / 0.5) ** 2, 0.5 * sqrt(ABOVE)),
    "steeper and steeper": (lambda d: d**4, ABOVE**0.25),
    "flatter and flatter": (lambda d: 2.0 * abs(d), ABOVE / 2.0),
    "flat, then a slope": (lambda d: 0.3 + 40.0 * max(0.0, abs(d) - 2.0), 2.0 + (ABOVE - 0.3) / 40.0),
}


@pytest.mark.parametrize("name", PROFILES)
@pytest.mark.parametrize("guess", [0.05, 1.0, 4.0])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_interval_ends_where_the_profile_does(name: str, guess: float, side: float) -> None:
    profile, reach = PROFILES[name]
    seen: list[float] = []

    def above(inner: float) -> float:
        seen.append(inner)
        return profile(inner - 7.0)

    end = _crossing(above, 7.0, side * guess, side * 1e6)
    # A guess that is wrong by a factor of 20 leaves fewer fits for the search.
    assert (end - 7.0) * side == pytest.approx(reach, rel=0.15 if guess >= 1.0 else 0.5)
    assert len(seen) <= 8


def test_a_bound_is_an_end() -> None:
    assert _crossing(lambda x: (x - 7.0) ** 2, 7.0, 1.96, 8.0) == 8.0
    assert _crossing(lambda x: (x - 7.0) ** 2, 7.0, -1.96, 6.5) == 6.5


def test_a_jump_is_bracketed() -> None:
    """The data only show that the stall pressure is between two pressures."""
    end = _crossing(lambda x: 0.0 if x < 451.3 else 900.0, 450.0, 1.0, 900.0)
    assert 451.3 <= end < 452.5
    end = _crossing(lambda x: 0.0 if x < 530.0 else 9e4, 420.0, 0.17, 900.0)
    assert 530.0 <= end < 540.0


@given(st.floats(420.2, 899.0))
def test_an_interval_does_not_end_before_a_wall(wall: float) -> None:
    assert _crossing(lambda x: 0.0 if x < wall else 9e4, 420.0, 0.17, 900.0) >= wall


def test_a_flat_profile_ends_at_the_bound() -> None:
    assert _crossing(lambda x: 0.0, 420.0, 0.17, 900.0) == 900.0


def plateau(height: float, edge: float) -> Callable[[float], float]:
    """A profile with a narrow minimum at 348.2, and a plateau up to `edge`."""
    return lambda x: min((x - 348.2) ** 2 / 0.1**2, height) if x < edge else 600.0


def with_plateau(above: Callable[[float], float], bound: float = 900.0) -> float:
    end = _crossing(above, 348.2, 0.2, bound)
    return _plateau_end(above, 348.2, end, bound, ABOVE, 2.0 * (end - 348.2))


@given(st.floats(352.0, 800.0))
def test_a_plateau_is_part_of_the_interval(edge: float) -> None:
    """The noise fits a little better near one end of the range that the data allow."""
    assert with_plateau(plateau(7.8, edge)) == pytest.approx(edge, rel=0.01)


def test_an_unlikely_plateau_is_not() -> None:
    assert with_plateau(plateau(30.0, 500.0)) < 349.0
    assert with_plateau(plateau(11.0, 349.5)) < 349.0


@pytest.mark.parametrize("name", ["a parabola", "steeper and steeper"])
def test_a_profile_without_plateau_keeps_its_end(name: str) -> None:
    profile, reach = PROFILES[name]
    seen: list[float] = []

    def above(x: float) -> float:
        seen.append(x)
        return profile(x)

    assert _plateau_end(above, 0.0, reach, 1e6, ABOVE, 2.0 * reach) == reach
    assert len(seen) == 1


def test_a_plateau_up_to_the_bound_ends_there() -> None:
    assert with_plateau(plateau(7.8, 1e9), 400.0) == 400.0
