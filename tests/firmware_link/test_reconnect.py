"""One policy of reconnecting: when each medium closes and opens again, and what is said about it."""

from __future__ import annotations

import asyncio
import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_link import reconnect, serial_port
from firmware_link.reconnect import (
    LONGEST_QUIET_S,
    SHORT_LIVED,
    STABLE_S,
    Change,
    KeptOpen,
    LinkState,
    Policy,
    Problem,
    Reconnect,
)
from flying_vines.gateway.mqtt import connection
from flying_vines.gateway.mqtt.broker import THROWN_OUT
from flying_vines.terminal import page_socket
from flying_vines.vehicle.mavlink import link

BROKER = connection.POLICY
MEDIA = {
    "serial": serial_port.POLICY,
    "network": link.POLICY,
    "listening": link.LISTENING,
    "page": page_socket.POLICY,
    "broker": BROKER,
}
AWAY = Problem("nothing answers there")
LOGIN = Problem("it does not accept this user and password", needs_person=True)
UP = Change(True, "")

of_all_media = pytest.mark.parametrize("policy", MEDIA.values(), ids=MEDIA)


def opened(policy: Policy, t: float = 0.0) -> Reconnect:
    one = Reconnect(policy, t)
    one.opening(t)
    one.opened(t)
    return one


def one_try(one: Reconnect, t: float, lasts_s: float, problem: Problem | None = AWAY) -> list[Change]:
    """A connection that opens at `t` and lasts for this time; the changes."""
    one.opening(t)
    found = [one.opened(t), one.lasts(t + lasts_s), one.ended(t + lasts_s, problem)]
    return [change for change in found if change]


def failed(one: Reconnect, t: float, problem: Problem = AWAY) -> Change | None:
    one.opening(t)
    return one.ended(t, problem)


def test_a_link_is_up_when_it_opens_and_a_reason_is_given_once() -> None:
    one = Reconnect(link.POLICY, 0.0)
    assert [failed(one, t) for t in (0.0, 1.0, 2.0)] == [Change(False, AWAY.text), None, None]
    one.opening(3.0)
    assert one.opened(3.0, "open") == Change(True, "open")
    assert one.lasts(4.0) is None
    assert one.ended(5.0, AWAY) == Change(False, AWAY.text)


def test_a_silent_connection_is_opened_again_without_a_word_and_ever_more_rarely() -> None:
    policy = link.POLICY
    one, t, waits = opened(policy), 0.0, []
    for _ in range(6):
        waits.append(next(wait for wait in range(1, 60) if one.overdue(t + wait)))
        t += waits[-1]
        assert one.ended(t, None) is None
        assert (one.state, one.wait_s(1.0), one.is_silent) == (LinkState.QUIET, 0.0, True)
        one.opening(t)
        assert one.opened(t) is None
    assert waits == [5, 10, 20, LONGEST_QUIET_S, LONGEST_QUIET_S, LONGEST_QUIET_S]
    one.heard(t + 1.0)
    assert not one.is_silent
    assert not one.overdue(t + 5.9) and one.overdue(t + 6.0)


def test_a_silent_peer_that_cannot_be_reached_again_is_down() -> None:
    one = opened(link.POLICY)
    one.ended(5.0, None)
    one.opening(5.0)
    assert one.ended(8.0, AWAY) == Change(False, AWAY.text)
    one.opening(9.0)
    assert one.opened(9.0) == UP


def test_a_peer_that_accepts_and_closes_at_once_is_soon_no_news() -> None:
    one = Reconnect(link.POLICY, 0.0)
    said = [change for t in range(0, 200, 10) for change in one_try(one, float(t), 0.1)]
    assert [change.up for change in said] == [True, False] * SHORT_LIVED
    assert said[-1].why == "it accepts the connection and closes it at once"
    one.opening(300.0)
    assert one.opened(300.0) is None
    assert one.lasts(300.0 + STABLE_S) == UP


def test_a_try_without_an_answer_is_given_up() -> None:
    one = Reconnect(page_socket.POLICY, 0.0)
    one.opening(0.0)
    assert not one.overdue(2.9) and one.overdue(3.0)
    assert one.ended(3.0, None) == Change(False, "no answer")


def test_a_reachable_broker_is_not_reported() -> None:
    one = Reconnect(BROKER, 0.0)
    assert one_try(one, 0.2, 60.0) == []


def test_a_broker_that_is_away_is_reported_once_and_that_it_is_back() -> None:
    one = Reconnect(BROKER, 0.0)
    said = [failed(one, t) for t in (0.0, 1.0, 3.0, 7.0, 15.0, 60.0)]
    assert said == [None, None, None, Change(False, AWAY.text), None, None]
    one.opening(69.0)
    assert one.opened(70.0) is None
    assert one.lasts(71.0) is None
    assert one.lasts(73.0) == UP
    assert one.lasts(74.0) is None


def test_a_short_interruption_of_the_broker_is_not_reported() -> None:
    one = Reconnect(BROKER, 0.0)
    for t in range(10, 1000, 10):
        assert one_try(one, float(t), 6.0) == []
        assert one.wait_s(1.0) == 1.0


def test_a_problem_that_needs_a_person_is_reported_at_once_and_tried_more_rarely() -> None:
    one = Reconnect(BROKER, 0.0)
    assert failed(one, 0.1, LOGIN) == Change(False, LOGIN.text)
    assert one.wait_s(1.0) == 15.0
    assert failed(one, 15.0, LOGIN) is None
    assert one.wait_s(1.0) == 30.0
    assert failed(one, 45.0, AWAY) == Change(False, AWAY.text)
    assert one.wait_s(1.0) == 4.0


def test_a_broker_that_lets_in_and_throws_out_again_and_again_is_no_good_connection() -> None:
    one = Reconnect(BROKER, 0.0)
    said = [change for t in range(0, 200, 10) for change in one_try(one, float(t), 1.0, LOGIN)]
    assert said == [Change(False, LOGIN.text)]
    assert one.wait_s(1.0) == 300.0


def test_connections_that_never_last_hint_at_a_second_vehicle_of_that_name() -> None:
    one = Reconnect(BROKER, 0.0)
    said = [change for t in range(3) for change in one_try(one, 2.0 * t, 1.0)]
    assert said == [Change(False, THROWN_OUT.text)]
    assert failed(one, 20.0) == Change(False, AWAY.text)


@of_all_media
@given(
    steps=st.lists(
        st.tuples(st.sampled_from(["fails", "refused", "opens", "silent", "heard"]), st.floats(0.0, 40.0)),
        max_size=60,
    ),
    luck=st.floats(0.0, 1.0),
)
def test_whatever_happens(policy: Policy, steps: list[tuple[str, float]], luck: float) -> None:
    """Waits are bounded and spread, nothing is said twice, and an open link that was silent is overdue."""
    one, t = Reconnect(policy, 0.0), 0.0
    said: list[Change] = []
    longest_s = max(policy.longest_wait_s, (policy.refused_waits_s or (0.0, 0.0))[1])
    for what, passed_s in steps:
        t += passed_s
        change: Change | None = None
        if what == "heard" and one.is_open:
            one.heard(t)
            change = one.lasts(t)
        elif what == "silent" and one.is_open:
            quiet_s = max(policy.quiet_s, LONGEST_QUIET_S)
            assert math.isinf(policy.quiet_s) or one.overdue(t + quiet_s)
            change = one.ended(t, None)
        else:
            if not one.is_open:
                one.opening(t)
            problem = LOGIN if what == "refused" else AWAY
            change = one.opened(t) if what == "opens" else one.ended(t, problem)
        said += [change] if change else []
        assert one.wait_s(0.0) <= one.wait_s(luck) <= one.wait_s(1.0) <= longest_s
        assert one.wait_s(0.0) >= (1.0 - policy.spread) * one.wait_s(1.0)
        assert one.state in (LinkState.QUIET, LinkState.OPEN) or one.wait_s(1.0) >= policy.first_wait_s
    assert all(before != after for before, after in pairwise(said))
    assert not any(before.up and after.up for before, after in pairwise(said))


async def test_a_connection_that_misses_its_cancellation_is_cancelled_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A library's `asyncio.wait_for` may lose a cancellation if an answer comes in the same turn."""
    monkeypatch.setattr(reconnect, "LEAVING_S", 0.02)
    cancelled = []

    async def deaf() -> Problem:
        try:
            await asyncio.sleep(3600)
        except asyncio.CancelledError:
            cancelled.append("missed")
        await asyncio.sleep(3600)
        raise AssertionError

    running = asyncio.create_task(KeptOpen(Policy(1.0, 1.0), deaf, lambda up, why: None).run())
    await asyncio.sleep(0.02)
    running.cancel()
    await asyncio.wait({running}, timeout=5.0)
    assert running.cancelled() and cancelled == ["missed"]


async def test_a_silent_connection_is_ended_and_opened_again_while_it_is_up() -> None:
    opened_at, states = [], []
    kept = KeptOpen(Policy(1.0, 1.0, quiet_s=0.3), lambda: connect(), lambda up, why: states.append(up))

    async def connect() -> Problem:
        kept.opened()
        opened_at.append(asyncio.get_running_loop().time())
        await asyncio.sleep(3600)
        raise AssertionError

    running = asyncio.create_task(kept.run())
    async with asyncio.timeout(5.0):
        while len(opened_at) < 3:
            await asyncio.sleep(0.02)
    running.cancel()
    await asyncio.wait({running})
    assert states == [True]
    assert opened_at[1] - opened_at[0] >= 0.3 and opened_at[2] - opened_at[1] >= 0.6
