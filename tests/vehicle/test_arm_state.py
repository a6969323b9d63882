"""The arm state, and two senders that contradict each other about it."""

from __future__ import annotations

import pytest

from flying_vines.vehicle.state import CONFLICT_S, REARMED_S, TWO_CLOCKS_S, ArmState, Clocks

PERIOD_S = 1.0


def told(*heartbeats: tuple[float, bool]) -> ArmState:
    state = ArmState()
    for t, armed in heartbeats:
        state.handle(t, armed)
    return state


def test_one_change_is_no_conflict() -> None:
    state = ArmState()
    for second in range(60):
        state.handle(second, armed=20 <= second < 40)
        assert not state.in_conflict(second)
        assert state.armed == (20 <= second < 40)
        assert state.armed_s(second + 0.5) == (second - 19.5 if state.armed else 0.0)


def test_a_vehicle_that_is_armed_for_a_moment_is_no_conflict() -> None:
    assert not told((0.0, False), (1.0, True), (2.0, False), (3.0, False)).in_conflict(3.0)


def test_armed_again_soon_after_disarmed_is_a_conflict_that_ends() -> None:
    state = told((0.0, True), (1.0, False), (1.0 + REARMED_S - 0.01, True))
    began = 1.0 + REARMED_S - 0.01
    assert state.in_conflict(began)
    assert state.in_conflict(began + CONFLICT_S - 0.01)
    assert not state.in_conflict(began + CONFLICT_S)


def test_armed_again_later_is_no_conflict() -> None:
    state = told((0.0, True), (1.0, False), (1.0 + REARMED_S, True))
    assert not state.in_conflict(1.0 + REARMED_S)


@pytest.mark.parametrize("rate_Hz", [1.0, 4.0, 50.0])
@pytest.mark.parametrize("real", [False, True])
def test_heartbeats_that_contradict_are_a_conflict_until_five_seconds_after_the_last(
    rate_Hz: float, real: bool
) -> None:
    truth = [(n * PERIOD_S, real) for n in range(40)]
    forged = [(10.307 + n / rate_Hz, not real) for n in range(round(10.0 * rate_Hz))]
    state, conflicts = ArmState(), []
    for t, armed in sorted(truth + forged):
        state.handle(t, armed)
        if state.in_conflict(t):
            conflicts.append(t)
    assert conflicts[0] <= 10.3 + 2 * PERIOD_S
    assert 20.0 <= conflicts[-1] <= 20.3 + PERIOD_S + CONFLICT_S
    assert len(conflicts) == sum(conflicts[0] <= t <= conflicts[-1] for t, _ in truth + forged)


# Two clocks.


def stamped(*stamps: tuple[float, float]) -> tuple[Clocks, list[bool]]:
    clocks = Clocks()
    return clocks, [clocks.stamp(t, boot_s) for t, boot_s in stamps]


def in_turns(seconds: float, ahead_s: float = 100.0) -> list[tuple[float, float]]:
    """The stamps of two autopilots, each at 5 Hz, for some seconds."""
    return [(0.1 * i, 500.0 + 0.1 * i + ahead_s * (i % 2)) for i in range(round(10 * seconds))]


def test_one_clock_and_one_reboot_are_no_conflict() -> None:
    clocks, back = stamped(*((0.1 * i, 500.0 + 0.1 * i if i < 50 else 0.1 * i) for i in range(100)))
    assert not any(back) and not clocks.in_conflict(10.0)


def test_two_clocks_in_turns_are_a_conflict_that_ends() -> None:
    stamps = in_turns(TWO_CLOCKS_S + 1.0)
    clocks, back = stamped(*stamps)
    last_t = stamps[-2][0]
    assert back.count(True) == len(stamps) // 2 - 2, "the first return may be a reboot"
    assert clocks.in_conflict(last_t + CONFLICT_S - 0.2)
    assert not clocks.in_conflict(last_t + CONFLICT_S + 0.2)


def test_a_short_return_is_no_conflict_yet() -> None:
    clocks, _ = stamped(*in_turns(TWO_CLOCKS_S - 0.2))
    assert not clocks.in_conflict(TWO_CLOCKS_S)


def test_reboots_again_and_again_are_no_second_clock() -> None:
    clocks, back = stamped(*((i, 20.0 * (i % 2)) for i in range(60)))
    assert not clocks.in_conflict(60.0)
    assert not any(back)


def test_a_return_after_a_long_time_is_a_reboot() -> None:
    clocks, back = stamped(
        *((t + s, 500.0 + t + s + b) for t in (0.0, 20.0, 40.0) for s, b in ((0, 99), (1, 0)))
    )
    assert not any(back) and not clocks.in_conflict(41.0)
