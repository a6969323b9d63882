"""Repeats of a command and copies of a frame are distinguished from a new equal command."""

from __future__ import annotations

import itertools

import pytest

from flying_vines.vehicle.repeats import (
    COPIES_WITHIN_S,
    MAX_COMMANDS,
    MAX_DELAY_DIFFERENCE_S,
    PX4_REPEAT_S,
    STATION_REPEAT_S,
    Repeats,
)


class Line:
    """Frames of one command, each with its own sequence number."""

    def __init__(self, repeat_s: float = PX4_REPEAT_S) -> None:
        self.repeats = Repeats()
        self.repeat_s = repeat_s
        self.sequence = itertools.count(250)

    def new(self, t: float, confirmation: int, sequence: int | None = None) -> bool:
        number = next(self.sequence) & 0xFF if sequence is None else sequence
        return not self.repeats.is_repeat(t, "command", confirmation, number, self.repeat_s)


@pytest.mark.parametrize("times", [(0.0, 0.5, 1.0, 1.5), (0.0, 1.0, 1.5, 2.0), (0.0, 0.01, 0.02, 0.5)])
@pytest.mark.parametrize("lost", [(), (0,), (0, 1), (0, 1, 2), (1,), (1, 2)])
def test_a_command_and_its_repeats_are_one(times: tuple[float, ...], lost: tuple[int, ...]) -> None:
    line = Line()
    arrived = [line.new(10.0 + t, n) for n, t in enumerate(times) if n not in lost]
    assert arrived == [True] + [False] * (len(arrived) - 1)


@pytest.mark.parametrize("order", list(itertools.permutations(range(4))))
def test_repeats_may_arrive_in_any_order_within_the_delay_of_a_link(order: tuple[int, ...]) -> None:
    line = Line()
    arrived = [line.new(10.0 + 0.1 * place, n) for place, n in enumerate(order)]
    assert arrived == [True, False, False, False]


@pytest.mark.parametrize("confirmation", [1, 2, 3])
def test_a_repeat_that_comes_too_late_is_of_another_command_whose_first_was_lost(confirmation: int) -> None:
    for late_s, new in ((-0.01, False), (0.01, True)):
        line = Line()
        assert line.new(10.0, 0)
        t = 10.0 + confirmation * PX4_REPEAT_S + MAX_DELAY_DIFFERENCE_S + late_s
        assert line.new(t, confirmation) is new


def test_a_ground_station_repeats_after_three_seconds() -> None:
    line = Line(STATION_REPEAT_S)
    assert [line.new(t, n) for n, t in enumerate((10.0, 13.0, 16.0, 19.0))] == [True, False, False, False]


def test_a_copy_of_a_frame_is_no_second_command_and_the_next_first_is() -> None:
    line = Line()
    assert line.new(10.0, 0, sequence=7)
    assert line.new(10.1, 0, sequence=8)
    assert not line.new(10.2, 0, sequence=7)
    assert not line.new(10.3, 0, sequence=8)
    assert line.new(10.2 + COPIES_WITHIN_S + 0.1, 0, sequence=7)


def test_the_answer_is_that_of_the_command_and_not_of_the_one_before() -> None:
    repeats = Repeats()
    repeats.answer("unknown", 2)
    assert repeats.answered("unknown") is None
    repeats.is_repeat(10.0, "command", 0, 1, PX4_REPEAT_S)
    repeats.answer("command", 2)
    repeats.is_repeat(10.5, "command", 1, 2, PX4_REPEAT_S)
    assert repeats.answered("command") == 2
    repeats.is_repeat(11.0, "command", 0, 3, PX4_REPEAT_S)
    assert repeats.answered("command") is None


def test_only_the_latest_commands_are_remembered() -> None:
    repeats = Repeats()
    for number in range(1000):
        repeats.is_repeat(10.0, number, 0, number & 0xFF, PX4_REPEAT_S)
    repeats.is_repeat(10.1, 1000 - MAX_COMMANDS, 1, 1, PX4_REPEAT_S)
    assert repeats.is_repeat(10.2, 999, 1, 2, PX4_REPEAT_S)
    assert not repeats.is_repeat(10.2, 5, 1, 3, PX4_REPEAT_S)
