"""Which telemetry is new by the board's clock, and which is repeated, frozen or out of order."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_link.device_clock import FULL_MS, ClockVerdict, DeviceClock
from firmware_link.host import HostSession
from firmware_link.protocol import PROTOCOL_VERSION, Fault, Hello, Mode, Telemetry, Welcome

STALE_S = 0.3
PERIOD_S = 0.01


def telemetry(device_time_ms: int) -> Telemetry:
    return Telemetry(device_time_ms, Mode.VENT, Fault.NONE, 0, 0.0, 1.0, 690.0, 0.0, 0.0, True)


def ready() -> HostSession:
    session = HostSession()
    session.opened(0.0)
    (hello,) = session.tick(0.0)
    assert isinstance(hello, Hello)
    session.receive(
        0.0, Welcome(PROTOCOL_VERSION, hello.nonce, 1, "test", 1, 30.0, 28.0, 760.0, 200.0, 300, 100)
    )
    return session


def verdicts(came: Iterable[tuple[float, int]]) -> list[ClockVerdict]:
    clock = DeviceClock()
    return [clock.take(t, ms % FULL_MS) for t, ms in came]


def oldest_after(session: HostSession, clock_ms: Callable[[float], int], began: float, for_s: float) -> float:
    """Minimum age of telemetry during this time, with a message every 10 ms."""
    ages = []
    for i in range(round(for_s / PERIOD_S)):
        t = began + i * PERIOD_S
        session.receive(t, telemetry(clock_ms(t)))
        ages.append(session.telemetry_age(t))
    return min(ages)


def flown(began_ms: int = 5000) -> HostSession:
    """A session with good telemetry for a second, until 1.0."""
    session = ready()
    for i in range(101):
        session.receive(i * PERIOD_S, telemetry((began_ms + 10 * i) % FULL_MS))
    assert session.telemetry_age(1.0) == 0.0
    return session


@pytest.mark.parametrize(
    "clock_ms",
    [
        lambda t: 6000,  # one frame, repeated
        lambda t: 5990 + 10 * (round(100 * t) % 2),  # two frames in turn
        lambda t: 5910 + 10 * (round(100 * t) % 10),  # a buffer that is sent again and again
        lambda t: 6000 + round(0.1 * 1000 * (t - 1.0)),  # a clock that runs ten times too slow
        # a clock that stops for a second
        lambda t: 6000 + round(1000 * (t - 1.0)) - min(1000, round(1000 * (t - 1.0))),
    ],
)
def test_a_clock_that_does_not_go_on_makes_no_telemetry_fresh(clock_ms: Callable[[float], int]) -> None:
    session = flown()
    oldest_after(session, clock_ms, 1.01, 0.65)
    assert session.telemetry_age(1.65) > STALE_S
    assert oldest_after(session, clock_ms, 1.66, 0.3) > STALE_S


@pytest.mark.parametrize("leap_ms", [100, 990, 60_000, 3_600_000])
def test_a_clock_that_leaps_with_each_message_makes_none_fresh(leap_ms: int) -> None:
    """Otherwise the physics checks, which skip gaps in the board's clock, would never run."""
    session = flown()
    oldest_after(session, lambda t: 6000 + round((t - 1.0) / PERIOD_S) * (10 + leap_ms), 1.01, 1.0)
    assert session.telemetry_age(2.0) > STALE_S or leap_ms == 100
    if leap_ms > 100:
        assert session.telemetry_gaps >= 90


def test_one_absurd_time_is_one_lost_message() -> None:
    session = flown()
    assert session.receive(1.01, telemetry(6010 + 86_400_000)) == []
    assert len(session.receive(1.02, telemetry(6020))) == 1
    assert session.telemetry == telemetry(6020)
    assert session.telemetry_gaps == 2


def test_a_lasting_leap_is_accepted_from_the_second_message_on() -> None:
    session = flown()
    assert session.receive(1.01, telemetry(3_606_010)) == []
    assert len(session.receive(1.02, telemetry(3_606_020))) == 1
    assert session.telemetry_age(1.02) == 0.0
    assert session.telemetry_gaps == 1


def test_the_age_of_a_backlog_is_by_the_boards_clock() -> None:
    """The host paused for 0.8 s: what waited comes at once, oldest first."""
    session = flown()
    ages = []
    for i in range(1, 81):
        session.receive(1.8, telemetry(6000 + 10 * i))
        ages.append(session.telemetry_age(1.8))
    assert ages[0] == pytest.approx(0.59, abs=0.01), "at least so old"
    assert ages == sorted(ages, reverse=True)
    assert ages[-1] == 0.0


def test_a_board_that_stopped_once_is_fresh_again() -> None:
    """An emulated board on a busy computer pauses; a real one restarts instead."""
    session = flown()
    oldest_after(session, lambda t: round(1000 * t) + 5000 - 2000, 3.0, 4.0)
    assert session.telemetry_age(7.0) <= 0.02


millis = st.integers(0, FULL_MS - 1)


@given(millis, st.lists(st.tuples(st.integers(1, 900), st.integers(0, 300)), min_size=1, max_size=60))
def test_a_true_clock_is_always_new(began_ms: int, steps: list[tuple[int, int]]) -> None:
    """This holds over any wrap, any losses and any delay that keeps the order."""
    came, made_ms, came_s = [], 0, 0.0
    for step_ms, delay_ms in steps:
        made_ms += step_ms
        came_s = max(came_s, (made_ms + delay_ms) / 1e3)
        came.append((came_s, began_ms + made_ms))
    assert set(verdicts(came)) == {ClockVerdict.NEW}


@given(millis, st.lists(st.integers(0, 60), min_size=1, max_size=200))
def test_each_time_is_new_once_however_often_and_in_what_order_it_comes(
    began_ms: int, sent: list[int]
) -> None:
    """Only a time later than all before it is new, so no old frame makes telemetry fresh again."""
    clock = DeviceClock()
    latest = -1
    for i, number in enumerate(sent):
        # Ten messages of 10 ms at most: nothing here is far enough back for a restart.
        number = max(number, latest - 9)
        verdict = clock.take(i * PERIOD_S, (began_ms + 200 + 10 * number) % FULL_MS)
        if verdict is ClockVerdict.NEW:
            assert number > latest
            latest = number
        elif verdict is not ClockVerdict.LEAPT and (began_ms + 200 + 10 * number) % FULL_MS >= 100:
            assert number <= latest


@given(st.lists(st.tuples(millis, st.floats(0.0, 0.05)), max_size=200))
def test_the_age_is_always_a_number_and_only_new_telemetry_lowers_it(
    said: list[tuple[int, float]],
) -> None:
    session = ready()
    t = 0.0
    for ms, later_s in said:
        t += later_s
        before = session.telemetry_age(t)
        events = session.receive(t, telemetry(ms))
        after = session.telemetry_age(t)
        assert after >= 0.0
        assert after == before or any(session.telemetry == getattr(e, "telemetry", None) for e in events)
        if session.state.value != "ready":
            return


@given(millis, st.floats(0.0, 0.5), st.floats(0.0, 0.02))
def test_a_slow_clock_is_stale_within_two_seconds_and_stays_so(
    began_ms: int, pace: float, jitter_s: float
) -> None:
    session = flown(began_ms)
    for i in range(1, 400):
        made_s = i * PERIOD_S
        t = 1.0 + made_s + (jitter_s if i % 7 == 0 else 0.0)
        session.receive(t, telemetry((began_ms + 1000 + int(1000 * pace * made_s)) % FULL_MS))
        assert made_s < 2.0 or session.telemetry_age(t) > STALE_S
