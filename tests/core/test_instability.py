"""Conditions that come and go: one text with a count, and no loss that lasts is hidden."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flying_vines.core.instability import (
    COUNT_EVERY_S,
    FORGOTTEN_AFTER_S,
    LATE_FOR_S,
    LOST_FOR_S,
    MAX_CONDITIONS,
    RESTARTS_END_AFTER_S,
    STABLE_AFTER_S,
    Lateness,
    OwnLines,
    Restarts,
)
from flying_vines.vehicle.notice import Notice, Severity

TICK_S = 0.1


def lost(t: float, condition: str = "RC") -> Notice:
    return Notice(t, Severity.WARNING, f"Vine: {condition} lost", condition=condition)


def back(t: float, condition: str = "RC") -> Notice:
    return Notice(t, Severity.NOTICE, f"Vine: {condition} is back", condition=condition, ended=True)


def shown(changes: dict[int, Notice], until_s: float) -> list[tuple[float, str]]:
    """The texts with their times. `changes`: the notices by tick."""
    lines = OwnLines()
    texts = []
    for tick in range(round(until_s / TICK_S)):
        t = tick * TICK_S
        notice = changes.get(tick)
        if notice is not None and lines.take(notice):
            texts.append((t, notice.text))
        texts += [(t, due.text) for due in lines.due(t)]
    return texts


def flapping(every: int, ticks: int) -> dict[int, Notice]:
    """Lost and back in turns."""
    return {tick: (back if (tick // every) % 2 else lost)(tick * TICK_S) for tick in range(0, ticks, every)}


def test_one_loss_and_its_end_are_told_at_once() -> None:
    texts = shown({10: lost(1.0), 13: back(1.3)}, 30.0)
    assert texts == [(1.0, "Vine: RC lost"), (1.3, "Vine: RC is back")]


def test_a_later_loss_is_a_new_one() -> None:
    later = round(1.3 / TICK_S + STABLE_AFTER_S / TICK_S) + 2
    texts = shown({10: lost(1.0), 13: back(1.3), later: lost(later * TICK_S)}, 30.0)
    assert texts[-1] == (later * TICK_S, "Vine: RC lost")


@pytest.mark.parametrize("every", [1, 2, 4, 9])
def test_a_flapping_link_is_one_line_with_a_count(every: int) -> None:
    changes = flapping(every, 1200)
    texts = shown(changes, 140.0)
    assert len(texts) <= 9, texts
    losses = sum(not notice.ended for notice in changes.values())
    assert re.search(rf"{losses} losses in \d+ s", texts[-1][1]), texts


@given(st.lists(st.integers(1, 120), max_size=40))
def test_a_loss_that_lasts_is_told_within_a_second_and_the_last_text_is_true(pauses: list[int]) -> None:
    changes, tick = {}, 0
    for number, pause in enumerate(pauses):
        tick += pause
        changes[tick] = (back if number % 2 else lost)(tick * TICK_S)
    if changes:
        last = changes[tick]
        within_s = FORGOTTEN_AFTER_S if last.ended else LOST_FOR_S
        assert shown(changes, (tick + 2) * TICK_S + within_s)[-1][1].startswith(last.text)


@given(st.lists(st.integers(1, 30), min_size=1, max_size=200))
def test_no_link_fills_the_screen(pauses: list[int]) -> None:
    changes, tick = {}, 0
    for number, pause in enumerate(pauses):
        tick += pause
        changes[tick] = (back if number % 2 else lost)(tick * TICK_S)
    minutes = tick * TICK_S / 60.0
    assert len(shown(changes, tick * TICK_S)) <= 3 + 30 * minutes


def test_the_same_text_again_and_again_is_counted() -> None:
    lines = OwnLines()
    notices = [Notice(0.02 * i, Severity.WARNING, "Vine: cannot write the log") for i in range(50)]
    assert [lines.take(notice) for notice in notices] == [True] + 49 * [False]
    assert lines.unstable(1.0) == {}, "it is no link"
    (counted,) = lines.due(1.0 + STABLE_AFTER_S)
    assert counted.text == "Vine: cannot write the log (50 times in 1 s)"
    again = {
        tick: Notice(tick * TICK_S, Severity.WARNING, "Vine: cannot write the log") for tick in range(130)
    }
    assert [text for _, text in shown(again, 12.9)][1:] == ["Vine: cannot write the log (101 times in 10 s)"]


def test_a_text_that_comes_rarely_is_told_each_time() -> None:
    rare = {tick: Notice(tick * TICK_S, Severity.WARNING, "Vine: no air") for tick in range(0, 600, 60)}
    assert [text for _, text in shown(rare, 80.0)] == 10 * ["Vine: no air"]


def test_a_condition_that_is_stable_again_is_forgotten() -> None:
    lines = OwnLines()
    for notice in flapping(1, 10).values():
        lines.take(notice)
    assert lines.unstable(0.9 + STABLE_AFTER_S - TICK_S)
    assert not lines.unstable(0.9 + STABLE_AFTER_S)
    lines.due(0.9 + STABLE_AFTER_S)
    lines.due(0.9 + FORGOTTEN_AFTER_S)
    assert lines._conditions == {}


def test_another_loss_of_the_same_name_is_told_within_a_second() -> None:
    worse = Notice(2.0, Severity.WARNING, "Vine: RC lost: also without power", condition="RC")
    texts = shown({10: lost(1.0), 20: worse}, 30.0)
    t, text = texts[1]
    assert t == pytest.approx(2.0 + LOST_FOR_S) and text == worse.text


def test_different_losses_do_not_hide_each_other() -> None:
    lines = OwnLines()
    for tick, notice in flapping(1, 50).items():
        lines.take(notice)
        if tick == 25:
            assert lines.take(lost(2.5, "phloSAR telemetry"))
    assert lines.unstable(5.0) == {"RC": "RC unstable: 25 losses in 5 s"}


def test_a_loss_that_vents_a_bent_vine_is_always_told_at_once() -> None:
    lines = OwnLines()
    lines.take(lost(0.0))
    lines.take(back(0.1))
    assert not lines.take(lost(0.2))
    assert lines.take(lost(0.3), at_once=True)


def test_a_loss_of_which_a_count_has_told_is_not_told_again_before_the_next_count() -> None:
    every = {tick: lost(tick * TICK_S) for tick in range(0, 40, 13)}
    assert [text for _, text in shown(every, 3.9 + STABLE_AFTER_S)] == ["Vine: RC lost"]


def test_the_last_count_comes_when_the_condition_is_stable_again() -> None:
    texts = shown(flapping(2, 248), 120.0)
    t, text = texts[-1]
    assert t <= 25.0 + STABLE_AFTER_S and text.endswith("back (62 losses in 25 s)"), texts


@pytest.mark.parametrize("every", [50, 70, 90])
def test_a_link_that_comes_and_goes_slowly_is_counted_too(every: int) -> None:
    texts = shown(flapping(every, 6000), 700.0)
    assert len(texts) <= 26, texts
    assert re.search(r"RC is back \(\d+ losses in \d+ s\)$", texts[-1][1]) or 6000 // every % 2 == 0, texts


def test_only_problems_are_counted() -> None:
    waiting = {tick: Notice(tick * TICK_S, Severity.NOTICE, "Vine: waiting for: a move") for tick in range(9)}
    assert shown(waiting, 90.0) == [(0.0, "Vine: waiting for: a move")]


def test_the_same_end_is_told_once() -> None:
    lines = OwnLines()
    assert [lines.take(notice) for notice in (lost(0.0), back(0.1), back(0.2))] == [True, True, False]
    assert not lines.take(replace(back(0.3), text="Vine: RC is off and not in use"))
    assert lines.due(COUNT_EVERY_S) == []


def test_many_texts_fill_no_memory() -> None:
    lines = OwnLines()
    for i in range(10 * MAX_CONDITIONS):
        assert lines.take(Notice(0.001 * i, Severity.WARNING, f"Vine: {i}"))
    assert len(lines._conditions) <= MAX_CONDITIONS


def test_a_loss_whose_text_changes_is_one_loss_and_its_new_text_is_told_when_it_lasts() -> None:
    late = replace(lost(1.5), text="Vine: RC late")
    texts = shown({10: lost(1.0), 15: late, 40: back(4.0)}, 20.0)
    assert [text for _, text in texts] == ["Vine: RC lost", "Vine: RC late", "Vine: RC is back"]
    assert shown({10: lost(1.0), 15: late, 20: back(2.0)}, 20.0)[1:] == [(2.0, "Vine: RC is back")]


def test_restarts_in_a_row_are_a_series() -> None:
    restarts = Restarts("phloSAR")
    restarts.note(0.0)
    assert restarts.looping(0.0) == ""
    restarts.note(4.0)
    assert restarts.looping(5.0) == "phloSAR restarted 2 times in 4 s"
    assert restarts.looping(4.0 + RESTARTS_END_AFTER_S) == ""


def test_a_late_event_is_the_computers_problem_for_some_time() -> None:
    lateness = Lateness(0.02)
    lateness.note(1.0)
    lateness.tick(1.0)
    lateness.note(1.2)
    assert lateness.problem(1.2) == ""
    lateness.note(1.36)
    lateness.tick(1.36)
    lateness.note(1.6)
    assert lateness.problem(1.7) == "this computer is too busy: late by 340 ms"
    assert lateness.problem(1.6 + LATE_FOR_S + 0.01) == ""
    lateness.tick(9.0)
    lateness.note(12.02)
    assert lateness.problem(12.02) == "this computer is too busy: late by 3.0 s"
