"""Texts about the broker: one for each kind of failure; and the times of new tries."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from flying_vines.gateway.mqtt.health import (
    MAX_WAIT_REFUSED_S,
    MAX_WAIT_S,
    THROWN_OUT,
    BrokerProblem,
    Health,
)

AWAY = BrokerProblem("nothing answers there")
LOGIN = BrokerProblem("it does not accept this user and password", needs_person=True)


def test_a_reachable_broker_is_not_reported() -> None:
    health = Health(0.0, "mqtt://b")
    health.connected(0.2)
    assert health.is_connected
    assert health.lasts(0.3) is health.lasts(60.0) is None


def test_a_broker_that_is_away_is_reported_once_and_that_it_is_back() -> None:
    health = Health(0.0, "mqtt://b")
    said = [health.failed(t, AWAY) for t in (0.0, 1.0, 3.0, 7.0, 15.0, 60.0)]
    assert said == [None, None, None, "MQTT: mqtt://b: nothing answers there", None, None]
    health.connected(70.0)
    assert health.lasts(71.0) is None
    assert health.lasts(73.0) == "MQTT: mqtt://b is back"
    assert health.lasts(74.0) is None


def test_a_short_interruption_is_not_reported() -> None:
    health = Health(0.0, "mqtt://b")
    for t in range(10, 1000, 10):
        health.connected(float(t))
        assert health.failed(t + 6.0, AWAY) is None
        assert health.wait_s(1.0) == 1.0


def test_a_problem_that_needs_a_person_is_reported_at_once_and_tried_more_rarely() -> None:
    health = Health(0.0, "mqtt://b")
    assert health.failed(0.1, LOGIN) == "MQTT: mqtt://b: it does not accept this user and password"
    assert health.wait_s(1.0) == 15.0
    assert health.failed(15.0, LOGIN) is None
    assert health.wait_s(1.0) == 30.0
    assert health.failed(45.0, AWAY) == "MQTT: mqtt://b: nothing answers there"
    assert health.wait_s(1.0) == 4.0


def test_one_that_is_let_in_and_thrown_out_again_and_again_is_no_good_connection() -> None:
    health = Health(0.0, "mqtt://b")
    told = []
    for t in range(0, 200, 10):
        health.connected(float(t))
        told += [health.lasts(t + 0.5), health.failed(t + 1.0, LOGIN)]
    assert [text for text in told if text] == ["MQTT: mqtt://b: it does not accept this user and password"]
    assert health.wait_s(1.0) == MAX_WAIT_REFUSED_S


@given(st.lists(st.sampled_from([AWAY, LOGIN]), min_size=1, max_size=80), st.floats(0, 1))
def test_waits_grow_to_a_bound_and_differ_from_vehicle_to_vehicle(
    said: list[BrokerProblem], luck: float
) -> None:
    health = Health(0.0, "mqtt://b")
    for t, problem in enumerate(said):
        health.failed(float(t), problem)
        longest_s = MAX_WAIT_REFUSED_S if problem.needs_person else MAX_WAIT_S
        assert 0.5 <= health.wait_s(luck) <= longest_s
        assert health.wait_s(0.0) <= health.wait_s(luck) <= health.wait_s(1.0) == 2 * health.wait_s(0.0)


def test_connections_that_never_last_hint_at_a_second_vehicle_of_that_name() -> None:
    health = Health(0.0, "mqtt://b")
    said = []
    for t in range(3):
        health.connected(2.0 * t)
        said.append(health.failed(2.0 * t + 1.0, AWAY))
    assert said == [None, None, f"MQTT: mqtt://b: {THROWN_OUT.text}"]
    assert health.failed(20.0, AWAY) == "MQTT: mqtt://b: nothing answers there"
