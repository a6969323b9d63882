"""Streams are requested one by one, again if they do not come, and reported if they never come."""

from __future__ import annotations

import itertools

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.streams import ASK_AGAIN_S, ASK_SPACING_S, MISSING_AFTER_S, REFUSED_S, Streams

WANTED_HZ = {65: 20.0, 1: 10.0, 33: 5.0, 42: 5.0, 2: 1.0, 29: 1.0}
TICK_S = 0.02

MESSAGES = {
    65: mavlink.MAVLink_rc_channels_message(0, 16, *(18 * [1500]), 255),
    1: mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 0, -1, -1, 0, 0, 0, 0, 0, 0),
    33: mavlink.MAVLink_global_position_int_message(0, 0, 0, 0, 0, 0, 0, 0, 0),
    42: mavlink.MAVLink_mission_current_message(0),
    2: mavlink.MAVLink_system_time_message(0, 0),
    29: mavlink.MAVLink_scaled_pressure_message(0, 1013.2, 0.0, 2000),
}


class Autopilot:
    """Ticks a `Streams`, and sends the requested messages, except those that it ignores."""

    def __init__(self, ignored: set[int] | None = None) -> None:
        self.streams = Streams(20.0)
        self.ignored = ignored or set()
        self.asked: list[tuple[float, int]] = []
        self.granted: set[int] = set()
        self.missing: list[str] = []
        self.ticks = 0

    @property
    def now_s(self) -> float:
        return self.ticks * TICK_S

    def run(self, for_s: float) -> list[tuple[float, int]]:
        """The requests in this time: (time, message id)."""
        before = len(self.asked)
        for _ in range(round(for_s / TICK_S)):
            for request in self.streams.requests(self.now_s, 7):
                self.take(request)
            for message_id in self.granted:
                if self.ticks % round(1 / WANTED_HZ[message_id] / TICK_S) == 0:
                    self.streams.handle(self.now_s, MESSAGES[message_id])
            self.missing = self.streams.missing(self.now_s)
            self.ticks += 1
        return self.asked[before:]

    def take(self, request: MavlinkMessage) -> None:
        assert (request.command, request.target_system, request.target_component) == (511, 7, 1)
        message_id = int(request.param1)
        assert 1e6 / request.param2 == WANTED_HZ[message_id]
        self.asked.append((self.now_s, message_id))
        self.streams.handle(self.now_s, mavlink.MAVLink_command_ack_message(511, 0, 0, 0, 7, 191))
        if message_id not in self.ignored:
            self.granted.add(message_id)


def test_each_stream_is_requested_once_and_not_together_with_others() -> None:
    autopilot = Autopilot()
    asked = autopilot.run(60.0)
    assert sorted(message_id for _, message_id in asked) == sorted(WANTED_HZ)
    times_s = [t for t, _ in asked]
    assert all(b - a >= ASK_SPACING_S - 1e-9 for a, b in itertools.pairwise(times_s))
    assert times_s[-1] < 1.0
    assert asked[0][1] == 65
    assert autopilot.missing == []


def test_never_more_than_one_request_at_a_time() -> None:
    streams = Streams(20.0)
    assert all(len(streams.requests(i * 0.001, 1)) <= 1 for i in range(20_000))


def test_a_missing_stream_is_requested_again_and_named() -> None:
    autopilot = Autopilot(ignored={1, 42})
    asked = autopilot.run(30.0)
    for silent in (1, 42):
        times_s = [t for t, message_id in asked if message_id == silent]
        assert 8 <= len(times_s) <= 11
        assert all(b - a >= ASK_AGAIN_S - 1e-9 for a, b in itertools.pairwise(times_s))
    assert [message_id for _, message_id in asked].count(65) == 1
    # A switch or a mission may be missing; arming, health and height may not.
    assert autopilot.missing == ["SYS_STATUS"]


def test_a_missing_stream_is_reported_in_time_and_withdrawn() -> None:
    autopilot = Autopilot(ignored={33})
    autopilot.run(MISSING_AFTER_S - 0.5)
    assert autopilot.missing == []
    autopilot.run(1.5)
    assert autopilot.missing == ["GLOBAL_POSITION_INT"]
    autopilot.ignored = set()
    autopilot.run(4.0)
    assert autopilot.missing == []


def test_a_stream_that_stops_is_requested_again() -> None:
    autopilot = Autopilot()
    autopilot.run(10.0)
    autopilot.granted.remove(33)
    again = autopilot.run(4.0)
    assert [message_id for _, message_id in again] == [33]
    assert again[0][0] < 10.0 + 2.1
    assert autopilot.run(20.0) == []


def test_a_slow_stream_is_not_silent_between_its_messages() -> None:
    autopilot = Autopilot()
    autopilot.run(30.0)
    assert [message_id for _, message_id in autopilot.asked].count(2) == 1


def test_after_a_reboot_everything_is_requested_at_once() -> None:
    autopilot = Autopilot()
    autopilot.run(10.0)
    autopilot.granted.clear()
    autopilot.streams.forget()
    asked = autopilot.run(1.0)
    assert sorted(message_id for _, message_id in asked) == sorted(WANTED_HZ)
    assert autopilot.missing == []


def test_no_stream_is_missing_before_it_was_requested() -> None:
    assert Streams(20.0).missing(1000.0) == []


@pytest.mark.parametrize(
    ("result", "pause_s"), [(0, ASK_AGAIN_S), (2, REFUSED_S), (3, REFUSED_S), (4, REFUSED_S)]
)
def test_an_unsupported_stream_is_not_soon_requested_again(result: int, pause_s: float) -> None:
    streams = Streams(20.0)
    asked: list[tuple[float, int]] = []
    for tick in range(round(100.0 / TICK_S)):
        t = tick * TICK_S
        for request in streams.requests(t, 1):
            asked.append((t, int(request.param1)))
            answer = result if asked[-1][1] in (29, 33) else 0
            streams.handle(t + 0.01, mavlink.MAVLink_command_ack_message(511, answer, 0, 0, 1, 191))
    # Required messages are always requested at the same rate, whatever the answer.
    for message_id, expected_s in ((29, pause_s), (33, ASK_AGAIN_S), (42, ASK_AGAIN_S)):
        times_s = [t for t, asked_id in asked if asked_id == message_id]
        gaps_s = [b - a for a, b in itertools.pairwise(times_s)]
        assert gaps_s and all(expected_s - 1e-6 <= gap <= expected_s + 0.7 for gap in gaps_s)


def test_a_late_refusal_belongs_to_no_request() -> None:
    streams = Streams(20.0)
    for tick in range(200):
        streams.requests(tick * TICK_S, 1)
    for _ in range(10):
        streams.handle(30.0, mavlink.MAVLink_command_ack_message(511, 2, 0, 0, 1, 191))
    asked = {
        int(request.param1) for tick in range(200) for request in streams.requests(30.0 + tick * TICK_S, 1)
    }
    assert asked == set(WANTED_HZ)


def test_nothing_is_missing_while_our_process_does_not_run_in_time() -> None:
    autopilot = Autopilot(ignored={33})
    for _ in range(20):
        autopilot.run(2.0)
        assert autopilot.missing == []
        autopilot.ticks += round(1.0 / TICK_S)
    autopilot.run(MISSING_AFTER_S + 1.0)
    assert autopilot.missing == ["GLOBAL_POSITION_INT"]


def test_nothing_is_missing_on_a_link_that_is_silent_and_just_after() -> None:
    """A dead link is reported once, and not as missing streams."""
    autopilot = Autopilot()
    autopilot.run(10.0)
    granted, autopilot.granted = autopilot.granted, set()
    for _ in range(20):
        autopilot.run(1.0)
        assert autopilot.missing == []
    autopilot.granted = granted - {1}
    autopilot.ignored = {1}
    autopilot.run(MISSING_AFTER_S - 0.5)
    assert autopilot.missing == []
    autopilot.run(1.0)
    assert autopilot.missing == ["SYS_STATUS"]
