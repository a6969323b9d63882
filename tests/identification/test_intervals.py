"""The crossing of a likelihood profile with its limit, for any shape."""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flying_vines.identification.intervals import ABOVE, _crossing

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
