"""The age of messages by the autopilot's clock."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from examples import examples
from flying_vines.vehicle.clock import BACKLOG_S, LATE_S, WAIT_FOR_STAMP_S, AutopilotClock, Mark

UP_S = 500.0


class Line:
    """An autopilot that started before t = 0, behind a link that may delay frames."""

    def __init__(self) -> None:
        self.clock = AutopilotClock()
        self.sequence = 0

    def frame(self, t: float, lost: int = 0) -> None:
        self.sequence += 1 + lost
        self.clock.frame(t, self.sequence & 0xFF)

    def stamp(self, sent_at: float, t: float | None = None, lost: int = 0) -> None:
        t = sent_at if t is None else t
        self.frame(t, lost)
        assert not self.clock.stamp(t, int((UP_S + sent_at) * 1000))

    def stream(self, until_t: float, every_s: float = 0.1, since_t: float = 0.0) -> None:
        for i in range(round((until_t - since_t) / every_s) + 1):
            self.stamp(since_t + i * every_s)

    def item(self, t: float, lost: int = 0) -> Mark:
        self.frame(t, lost)
        return self.clock.mark(t)

    def age_s(self, mark: Mark, t: float) -> float:
        age_s = self.clock.age_s(mark, t)
        assert age_s is not None
        return age_s


def test_on_a_good_link_no_message_is_old() -> None:
    line = Line()
    line.stream(5.0)
    assert line.age_s(line.item(5.05), 5.05) == 0.0


def test_without_a_clock_nothing_is_late() -> None:
    line = Line()
    for t in (1.0, 9.0):
        mark = line.item(t)
        assert line.clock.age_s(mark, t) is None
        assert line.age_s(mark, t + WAIT_FOR_STAMP_S) == pytest.approx(WAIT_FOR_STAMP_S)


@pytest.mark.parametrize("stamp_first", [True, False])
def test_messages_from_before_our_start_have_the_age_of_adjacent_ones(stamp_first: bool) -> None:
    """The first message may have waited as long as the messages that arrive with it."""
    line = Line()
    if stamp_first:
        line.stamp(-3.0, 0.0)
    mark = line.item(0.0)
    for i in range(31):
        line.stamp(-3.0 + i * 0.1, 0.001)
    assert line.clock.age_s(mark, 0.2) is None
    assert line.age_s(mark, 0.3) == pytest.approx(3.3, abs=0.2)


@pytest.mark.parametrize("every_s", [0.1, 1.0])
def test_messages_of_a_stalled_link_have_the_age_of_adjacent_ones(every_s: float) -> None:
    line = Line()
    line.stream(10.0, every_s)
    marks = []
    for i in range(1, round(7.0 / every_s)):
        marks.append((10.0 + i * every_s, line.item(17.0)))
        line.stamp(10.0 + i * every_s, 17.0)
    for sent_at, mark in marks:
        assert line.age_s(mark, 17.0) == pytest.approx(17.0 - sent_at if sent_at < 16.0 else 0.0, abs=1.01)


def test_the_age_of_the_first_message_of_a_burst_waits_for_the_next_time_stamp() -> None:
    line = Line()
    line.stream(10.0)
    mark = line.item(17.0)
    assert line.clock.age_s(mark, 17.0) is None
    line.stamp(10.2, 17.001)
    assert line.age_s(mark, 17.02) == pytest.approx(6.82, abs=0.05)


def test_the_beginning_of_a_burst_is_old_even_if_its_end_was_lost() -> None:
    """A process paused for longer than its buffer can store."""
    line = Line()
    line.stream(10.0)
    line.stamp(10.1, 16.0)
    mark = line.item(16.0)
    line.stamp(15.95, 16.01, lost=90)
    assert line.age_s(mark, 16.01) > 4.0


def test_the_first_message_after_a_cut_link_is_new() -> None:
    line = Line()
    line.stream(10.0)
    mark = line.item(14.0, lost=30)
    assert line.clock.age_s(mark, 14.0) is None
    line.stamp(14.05)
    assert line.age_s(mark, 14.05) == pytest.approx(0.05)
    # Without a time stamp the age is unknown.
    line = Line()
    line.stream(10.0)
    mark = line.item(14.0, lost=30)
    assert line.age_s(mark, 14.0 + WAIT_FOR_STAMP_S) > LATE_S


def test_a_stream_that_has_stopped_makes_nothing_late() -> None:
    line = Line()
    line.stream(10.0)
    for i in range(1, 60):
        line.frame(10.0 + i)
        assert line.age_s(line.item(10.0 + i + 0.5), 10.0 + i + 0.5) == 0.0


def test_a_stall_is_forgotten_although_no_stamp_follows() -> None:
    line = Line()
    line.stream(10.0)
    for i in range(6):
        line.frame(17.0 + i)
    assert line.age_s(line.item(22.5), 22.5) == 0.0


def test_a_slow_stream_makes_nothing_late() -> None:
    line = Line()
    line.stream(0.0, since_t=-BACKLOG_S)
    for t in range(1, 100):
        line.frame(float(t))
        if t % 7 == 0:
            line.stamp(float(t))
        assert line.age_s(line.item(t + 0.9), t + 0.9) == 0.0


@pytest.mark.parametrize(
    ("pace", "answers"),
    [(0.98, False), (0.986, False), (0.9999, False), (1.0001, False), (1.02, False)]
    + [(pace, True) for pace in (0.6, 0.87, 0.95, 1.0, 1.3)],
)
def test_a_clock_with_a_wrong_rate_makes_nothing_late_and_hides_no_stall(pace: float, answers: bool) -> None:
    """A simulated autopilot may be slow. The answers to our requests show that its messages are not late."""
    clock = AutopilotClock()
    for i in range(6000):
        t = i * 0.1
        if answers and i % 10 == 9:
            clock.answered(t, t - 0.1)
        assert not clock.stamp(t, int((UP_S + t * pace) * 1000))
        assert t < BACKLOG_S or clock.age_s(clock.mark(t), t) == 0.0
    clock.stamp(606.0, int((UP_S + 600.1 * pace) * 1000))
    mark = clock.mark(606.0)
    clock.stamp(606.0, int((UP_S + 600.2 * pace) * 1000))
    assert clock.age_s(mark, 606.0) == pytest.approx(5.8, abs=0.5)


def test_one_stamp_ahead_makes_requests_late_only_until_the_next_answer() -> None:
    line = Line()
    line.stream(100.0)
    line.clock.stamp(100.05, int((UP_S + 115.0) * 1000))
    line.clock.answered(100.95, 100.9)
    line.stream(103.0, since_t=101.0)
    assert line.age_s(line.item(103.05), 103.05) == 0.0


def test_a_delay_that_grows_is_no_slow_clock() -> None:
    """The answers are as late as all else: a full radio link."""
    clock = AutopilotClock()
    for i in range(600):
        t = i * 0.1
        delay_s = 0.1 * t
        if i % 10 == 9:
            clock.answered(t, t - delay_s - 0.05)
        assert not clock.stamp(t, int((UP_S + t - delay_s) * 1000))
    mark = clock.mark(60.0)
    clock.stamp(60.1, int((UP_S + 54.1) * 1000))
    assert (clock.age_s(mark, 60.1) or 0.0) > 4.0


@pytest.mark.parametrize(("round_trip_s", "late"), [(0.3, False), (0.9, False), (1.1, True), (5.0, True)])
def test_a_link_that_is_late_from_the_start_is_known_by_slow_answers(round_trip_s: float, late: bool) -> None:
    line = Line()
    for t in range(20):
        if t >= round_trip_s:
            line.clock.answered(float(t), t - round_trip_s)
        line.stamp(t - round_trip_s, float(t))
    assert (line.clock.delay_s(20.0) > LATE_S) is late
    line.clock.answered(20.5, 20.4)
    assert line.clock.delay_s(20.5) < LATE_S


def test_slow_answers_of_long_ago_count_no_more() -> None:
    clock = AutopilotClock()
    for t in (2.0, 3.0, 4.0):
        clock.answered(t, t - 2.0)
    assert clock.delay_s(4.0) == 2.0
    assert clock.delay_s(20.0) == 0.0


def test_a_reboot_is_no_stall() -> None:
    line = Line()
    line.stream(10.0)
    line.frame(20.0)
    assert line.clock.stamp(20.0, 3000)
    mark = line.item(20.1)
    assert line.age_s(mark, 20.1 + WAIT_FOR_STAMP_S) == pytest.approx(WAIT_FOR_STAMP_S)


def test_a_stall_in_an_autopilots_first_minute_is_no_reboot() -> None:
    clock = AutopilotClock()
    for i in range(100):
        assert not clock.stamp(i * 0.1, 20_000 + i * 100)
    for i in range(100, 160):
        assert not clock.stamp(16.0, 20_000 + i * 100)
    assert clock.time_boot_ms(16.0) == pytest.approx(36_000, abs=50)


def test_a_time_that_stops_is_no_reboot() -> None:
    line = Line()
    line.stream(10.0)
    for i in range(600):
        assert not line.clock.stamp(10.0 + i * 0.1, int((UP_S + 10.0) * 1000), is_measured=True)


def test_a_time_stamp_that_stops_is_no_reboot_while_another_continues() -> None:
    line = Line()
    for i in range(600):
        line.stamp(i * 0.1)
        assert not line.clock.stamp(i * 0.1, int(UP_S * 1000), is_measured=True)
    assert line.age_s(line.item(59.95), 59.95) == 0.0


def test_the_time_of_a_measurement_is_a_clock() -> None:
    clock = AutopilotClock()
    assert not clock.stamp(1.0, 30_000, is_measured=True)
    assert clock.time_boot_ms(2.0) == 31_000


def test_a_clock_that_begins_at_zero_again_after_49_days_is_no_reboot() -> None:
    clock, wraps_ms = AutopilotClock(), 1 << 32
    for i in range(200):
        clock.frame(i * 0.1, i & 0xFF)
        assert not clock.stamp(i * 0.1, (wraps_ms - 10_000 + i * 100) % wraps_ms)
    assert clock.age_s(clock.mark(19.95), 19.95) == 0.0
    assert clock.time_boot_ms(20.0) == pytest.approx(10_000, abs=100)


def test_a_message_of_another_sender_may_be_as_old_as_the_silence_before() -> None:
    """The autopilot's own frames, which show the age, come after it."""
    line = Line()
    line.stream(10.0)
    mark = line.clock.mark(17.0)
    assert line.clock.age_s(mark, 17.0) is None
    line.stamp(10.2, 17.001)
    assert line.age_s(mark, 17.02) == pytest.approx(6.82, abs=0.05)


def test_between_two_heartbeats_a_message_of_another_sender_is_not_old() -> None:
    line = Line()
    line.stream(10.0)
    assert line.age_s(line.clock.mark(11.15), 11.15) == 0.0


def test_messages_that_were_late_before_a_reboot_stay_late() -> None:
    line = Line()
    line.stream(10.0)
    mark = line.item(17.0)
    line.stamp(10.2, 17.001)
    line.clock.forget()
    assert line.age_s(mark, 17.4) > LATE_S


@given(seed=st.integers(0, 2**32), every_s=st.floats(0.02, 1.0), stall_s=st.floats(0.0, 12.0))
@settings(max_examples=examples(150), deadline=None)
def test_no_new_item_is_late_and_every_old_item_is(seed: int, every_s: float, stall_s: float) -> None:
    """Streams of any spacing up to a second on a link that is late by up to 0.3 s and stalls once."""
    dice = random.Random(seed)
    sent: list[tuple[float, bool]] = []
    t = 0.0
    while t < 40.0:
        sent.append((t, True))
        t += every_s * dice.uniform(0.2, 1.0)
    sent += [(dice.uniform(5.0, 40.0), False) for _ in range(20)]
    stalls_at = dice.uniform(5.0, 25.0)
    line, arrives_at = Line(), 0.0
    open_marks: list[tuple[float, Mark]] = []
    for sent_at, is_stamp in sorted(sent):
        held_s = stalls_at + stall_s - sent_at if stalls_at <= sent_at <= stalls_at + stall_s else 0.0
        arrives_at = max(arrives_at, sent_at + held_s + dice.uniform(0.0, 0.3))
        for item_at, mark in open_marks[:]:
            for decided_at in (mark.t, min(mark.t + WAIT_FOR_STAMP_S, arrives_at)):
                age_s = line.clock.age_s(mark, decided_at)
                if age_s is not None and (item_at, mark) in open_marks:
                    open_marks.remove((item_at, mark))
                    check(age_s, decided_at - item_at)
        if is_stamp:
            line.stamp(sent_at, arrives_at)
        else:
            open_marks.append((sent_at, line.item(arrives_at)))


def check(age_s: float, really_s: float) -> None:
    if really_s < LATE_S:
        assert age_s <= LATE_S
    if really_s > 2.0 + 0.35:
        assert age_s > LATE_S
