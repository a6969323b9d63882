"""The transmit queue sends no bursts, sends important messages first, and loses nothing without need."""

from __future__ import annotations

from collections.abc import Callable

from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from examples import examples
from flying_vines.vehicle.component.requests import autopilot_version
from flying_vines.vehicle.component.transmit_queue import MAX_WAITING, TransmitQueue, acknowledgement
from flying_vines.vehicle.mavlink.codec import MavlinkMessage

TICK_S = 0.02
LATE_S = 0.002
HEARTBEAT = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 3, 3)


def answer(number: int = 0) -> MavlinkMessage:
    asked = mavlink.MAVLink_command_long_message(1, 191, 31010, 0, number, 0, 0, 0, 0, 0, 0)
    return acknowledgement(asked, 0, number % 100)


def text(number: int = 0) -> MavlinkMessage:
    return mavlink.MAVLink_statustext_message(4, f"Vine: {number}".encode(), 0, 0)


def request(number: int = 0) -> MavlinkMessage:
    return mavlink.MAVLink_mission_request_int_message(1, 1, number)


def parameter(number: int = 0) -> MavlinkMessage:
    return mavlink.MAVLink_param_value_message(b"VINE_MAX_KPA", float(number), 9, 16, 8)


def value(number: int = 0) -> MavlinkMessage:
    return mavlink.MAVLink_named_value_float_message(number, b"CV_KPA", 3.0)


Maker = Callable[[int], MavlinkMessage]
MAKERS: tuple[Maker, ...] = (answer, text, request, parameter, value)
"""In the order of sending."""


def test_important_messages_are_sent_first_and_others_one_at_a_time() -> None:
    queue = TransmitQueue()
    put = [value(), parameter(), request(), text(), answer(), HEARTBEAT]
    for message in put:
        queue.put(message)
    left = [[message.get_type() for message in queue.due(i * TICK_S)] for i in range(6)]
    assert left == [
        ["HEARTBEAT", "COMMAND_ACK"],
        ["STATUSTEXT"],
        ["MISSION_REQUEST_INT"],
        ["PARAM_VALUE"],
        ["NAMED_VALUE_FLOAT"],
        [],
    ]


def test_there_is_always_room_for_an_answer_beside_the_rest() -> None:
    queue = TransmitQueue()
    for number in range(10):
        queue.put(value(number))
    for i in range(10):
        assert [message.get_type() for message in queue.due(i * TICK_S)] == ["NAMED_VALUE_FLOAT"]
        queue.put(answer(i))
        assert [message.get_type() for message in queue.due(i * TICK_S + 0.001)] == ["COMMAND_ACK"]


def test_every_requested_message_is_sent_as_an_answer() -> None:
    queue = TransmitQueue()
    queue.put(text())
    queue.put(mavlink.MAVLink_timesync_message(1, 2))
    queue.put(autopilot_version())
    assert [message.get_type() for message in queue.due(0.0)] == ["TIMESYNC", "AUTOPILOT_VERSION"]


def test_an_answer_is_sent_at_once_if_no_message_was_just_sent() -> None:
    queue = TransmitQueue()
    queue.put(answer())
    assert len(queue.due(5.0)) == 1


def test_in_a_full_queue_the_oldest_message_of_the_lowest_priority_is_dropped() -> None:
    queue = TransmitQueue()
    for number in range(MAX_WAITING):
        queue.put(value(number))
    queue.put(answer())
    queue.put(HEARTBEAT)
    assert queue.dropped == 2
    left = [message for i in range(2 * MAX_WAITING) for message in queue.due(i * TICK_S)]
    assert [message.get_type() for message in left[:2]] == ["HEARTBEAT", "COMMAND_ACK"]
    assert [message.time_boot_ms for message in left[2:]] == list(range(2, MAX_WAITING))


def test_a_flood_of_commands_drops_answers_but_no_heartbeat() -> None:
    queue = TransmitQueue()
    beats = []
    for i in range(500):
        for number in range(20):
            queue.put(answer(number))
        if i % 50 == 0:
            queue.put(HEARTBEAT)
        beats += [i for message in queue.due(i * TICK_S) if message.get_type() == "HEARTBEAT"]
    assert beats == list(range(0, 500, 50))
    assert queue.dropped > 0


def test_a_flood_of_commands_drops_no_text_and_no_answer_to_another_sender() -> None:
    queue = TransmitQueue()
    put: dict[str, list[MavlinkMessage]] = {"STATUSTEXT": [], "COMMAND_ACK": []}
    left: list[tuple[int, MavlinkMessage]] = []
    for i in range(500):
        for number in range(20):
            queue.put(answer(number))
        if i % 5 == 0:
            put["STATUSTEXT"].append(text(i))
            queue.put(put["STATUSTEXT"][-1])
        if i % 50 == 10:
            asked = mavlink.MAVLink_command_long_message(1, 191, 31013, 0, 0, 0, 0, 0, 0, 0, 0)
            asked._header.srcSystem, asked._header.srcComponent = 255, 190
            put["COMMAND_ACK"].append(acknowledgement(asked, 0))
            queue.put(put["COMMAND_ACK"][-1])
        left += [(i, message) for message in queue.due(i * TICK_S)]
    left_at = {id(message): i for i, message in left}
    assert all(left_at[id(message)] - 5 * n <= 2 for n, message in enumerate(put["STATUSTEXT"]))
    assert all(left_at[id(message)] - 10 - 50 * n <= 50 for n, message in enumerate(put["COMMAND_ACK"]))


def vent_of(system: int) -> MavlinkMessage:
    asked = mavlink.MAVLink_command_long_message(1, 191, 31013, 0, 0, 0, 0, 0, 0, 0, 0)
    asked._header.srcSystem, asked._header.srcComponent = system, 190
    return acknowledgement(asked, 0, lets_air_out=True)


def test_of_the_answers_to_many_senders_that_to_a_vent_is_kept() -> None:
    queue = TransmitQueue()
    vent = vent_of(255)
    queue.put(vent)
    for system in range(200):
        refused = mavlink.MAVLink_command_long_message(1, 191, 31010, 0, 0, 0, 0, 0, 0, 0, 0)
        refused._header.srcSystem = system
        queue.put(acknowledgement(refused, 2))
    assert queue.due(0.0)[0] is vent


def test_a_flood_of_vents_drops_no_answer_to_another_sender() -> None:
    queue = TransmitQueue()
    other = answer()
    queue.put(other)
    for _ in range(200):
        queue.put(vent_of(77))
    assert queue.due(0.0)[0] is other


class Line:
    """A queue that is read as by the core: at each tick, which is never exactly on time, and after each
    event."""

    def __init__(self) -> None:
        self.queue = TransmitQueue()
        self.t = 0.0
        self.put: list[MavlinkMessage] = []
        self.left: list[tuple[float, MavlinkMessage]] = []
        self._ticks = 1

    def wait(self, for_s: float) -> None:
        self.t += for_s
        while (tick_at := self._ticks * TICK_S + LATE_S * (self._ticks * 37 % 100) / 100) <= self.t:
            self.ask(tick_at)
            self._ticks += 1

    def take(self, *messages: MavlinkMessage) -> None:
        for message in messages:
            self.put.append(message)
            self.queue.put(message)
        self.ask(self.t)

    def ask(self, t: float) -> None:
        self.left += [(t, message) for message in self.queue.due(t)]

    def left_at(self, message: MavlinkMessage) -> float:
        return next(t for t, other in self.left if other is message)


PAUSES_S = st.floats(0.0, 0.08)
LOADS = st.lists(
    st.tuples(PAUSES_S, st.lists(st.sampled_from((*MAKERS, lambda number: HEARTBEAT)), max_size=9)),
    min_size=1,
    max_size=80,
)


@given(LOADS)
@settings(max_examples=examples(150), deadline=None)
def test_there_is_no_burst_and_no_loss_and_each_priority_keeps_its_order(
    loads: list[tuple[float, list[Maker]]],
) -> None:
    line = Line()
    for pause_s, makers in loads:
        line.wait(pause_s)
        line.take(*(maker(number) for number, maker in enumerate(makers)))
    line.wait(3.0)
    times_s = [t for t, _ in line.left]
    assert all(third - first >= TICK_S - 1e-5 for first, third in zip(times_s, times_s[2:], strict=False))
    assert len(line.left) == len(line.put) - line.queue.dropped
    came = [message for _, message in line.left]
    for kind in {message.get_type() for message in came}:
        those = [id(message) for message in came if message.get_type() == kind]
        put = iter(id(message) for message in line.put)
        assert all(one in put for one in those)  # `in` uses up the iterator, so this checks the order


@given(LOADS, PAUSES_S)
@settings(max_examples=examples(100), deadline=None)
def test_an_answer_and_a_heartbeat_wait_two_ticks_at_most(
    loads: list[tuple[float, list[Maker]]], pause_s: float
) -> None:
    line = Line()
    for before_s, makers in loads:
        line.wait(before_s)
        line.take(*(maker(0) for maker in makers if maker in MAKERS[1:]))
    line.wait(pause_s)
    beat, late = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3), answer()
    taken_at = line.t
    line.take(beat, late)
    line.wait(0.1)
    assert line.left_at(beat) <= line.left_at(late) <= taken_at + 2 * TICK_S + LATE_S
