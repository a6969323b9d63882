"""The Pareto front: no choice is better in both criteria than one on it."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flying_vines.studies.design import Evaluation, catalogue, demonstration, evaluate, search
from flying_vines.studies.design.evaluate import Performance, choices, evaluate_all, front

CATALOGUE = catalogue()
TRIED = evaluate_all(demonstration(), CATALOGUE)
ONE = evaluate(demonstration(), CATALOGUE.choose())
WAYS: tuple[Performance, ...] = ("cycles", "inflation", "deflation")


def beats(a: Evaluation, b: Evaluation, by: Performance) -> bool:
    better = (a.mass_kg <= b.mass_kg, a.performance(by) >= b.performance(by))
    strictly = a.mass_kg < b.mass_kg or a.performance(by) > b.performance(by)
    return all(better) and strictly


def check(found: list[Evaluation], tried: list[Evaluation], by: Performance) -> None:
    meeting = [e for e in tried if not e.shortfalls]
    assert bool(found) == bool(meeting)
    for one in found:
        assert not one.shortfalls
        assert not any(beats(other, one, by) for other in meeting)
    for one in meeting:
        equal = [(e.mass_kg, e.performance(by)) for e in found]
        assert (one.mass_kg, one.performance(by)) in equal or any(beats(e, one, by) for e in found)


@pytest.mark.parametrize("by", WAYS)
def test_the_front_of_the_catalogue_holds_no_dominated_choice(by: Performance) -> None:
    found = search(demonstration(), CATALOGUE, by)
    assert found
    check(found, TRIED, by)


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(1, 8), st.integers(300, 308)), max_size=12))
def test_the_front_of_any_choices_holds_no_dominated_one(pairs: list[tuple[int, int]]) -> None:
    tried = [replace(ONE, mass_kg=0.1 * mass, cycles_rigid=float(cycles)) for mass, cycles in pairs]
    found = front(tried)
    check(found, tried, "cycles")
    assert [e.mass_kg for e in found] == sorted({e.mass_kg for e in found})


def test_every_choice_is_tried_once() -> None:
    tried = list(choices(CATALOGUE))
    assert len(tried) == len({repr(parts) for parts in tried})
    assert CATALOGUE.choose() in tried


def test_a_robot_that_nothing_serves_has_no_front() -> None:
    from flying_vines.studies.design.robot import parse

    text = 'name = "r"\ncv_volume_L = 100.0\npressure_kPa = 50.0\nfrequency_Hz = 5.0\npayload_kg = 1.0\n'
    assert search(parse(text, "r.toml"), CATALOGUE) == []
