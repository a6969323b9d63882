"""The stored mission is read over a bad link, and read again whenever it may have changed."""

from __future__ import annotations

import itertools
import random
import struct
from collections.abc import Sequence

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.mission.item import MissionItem
from flying_vines.vehicle.mission.mission_cache import MAX_ATTEMPTS, RETRY_S, TRY_AGAIN_S, MissionCache

TICK_S = 0.02


def sent(message: MavlinkMessage) -> MavlinkMessage:
    """The message as the other side of a link has it."""
    return mavlink.MAVLink(None).parse_char(message.pack(mavlink.MAVLink(None, 1, 1)))


def item(seq: int, command: int = 16, *params: float) -> MissionItem:
    p1, p2, p3, p4 = [*params, 0.0, 0.0, 0.0, 0.0][:4]
    return MissionItem(seq, command, (p1, p2, p3, p4, 0.0, 0.0, 0.0))


def mission(size: int, angle_deg: float = 40.0) -> list[MissionItem]:
    return [item(seq, 217, 1.0, angle_deg + seq) if seq % 3 == 2 else item(seq) for seq in range(size)]


def current(total: int, mission_id: int = 0, seq: int = 0) -> MavlinkMessage:
    """MISSION_CURRENT with its newer fields, which the dialect does not name."""
    payload = struct.pack("<HHBBIII", seq, total, 0, 0, mission_id, 0, 0)
    header = bytes((len(payload), 0, 0, 0, 1, 1, 42, 0, 0))
    checksum = mavlink.x25crc(header + payload + bytes((28,))).crc
    message = mavlink.MAVLink(None).parse_char(b"\xfd" + header + payload + struct.pack("<H", checksum))
    assert message.get_type() == "MISSION_CURRENT"
    return message


def text(words: str) -> MavlinkMessage:
    return sent(mavlink.MAVLink_statustext_message(6, words.encode(), 0, 0))


def item_message(one: MissionItem, mission_type: int = 0) -> MavlinkMessage:
    p1, p2, p3, p4, x, y, z = one.params
    return sent(
        mavlink.MAVLink_mission_item_int_message(
            1, 191, one.seq, one.frame, one.command, 0, 1, p1, p2, p3, p4, int(x), int(y), z, mission_type
        )
    )


def count_message(count: int, mission_type: int = 0) -> MavlinkMessage:
    return sent(mavlink.MAVLink_mission_count_message(1, 191, count, mission_type))


class Autopilot:
    """Serves a mission to a cache, on a link that loses a share of the frames in both directions."""

    def __init__(self, items: Sequence[MissionItem], loss: float = 0.0, seed: int = 1) -> None:
        self.items = list(items)
        self.cache = MissionCache()
        self.loss = loss
        self.total = len(self.items)
        self.mission_id = 0
        self.acknowledged = 0
        self.requests = 0
        self.ticks = 0
        self._dice = random.Random(seed)

    @property
    def now_s(self) -> float:
        return self.ticks * TICK_S

    def arrives(self) -> bool:
        return self._dice.random() >= self.loss

    def deliver(self, message: MavlinkMessage) -> None:
        self.cache.handle(self.now_s, message)
        self.acknowledged += len(self.cache.acknowledgement(1))

    def run(self, for_s: float) -> None:
        for _ in range(round(for_s / TICK_S)):
            requests = self.cache.requests(self.now_s, 1, True)
            assert len(requests) <= 1
            for request in requests:
                self.requests += 1
                if self.arrives() and self.arrives():
                    self.answer(request)
            if self.ticks % 10 == 0 and self.arrives():
                self.deliver(current(self.total, self.mission_id))
            self.ticks += 1

    def answer(self, request: MavlinkMessage) -> None:
        assert (request.target_system, request.target_component, request.mission_type) == (1, 1, 0)
        if request.get_type() == "MISSION_REQUEST_LIST":
            self.deliver(count_message(len(self.items)))
        else:
            self.deliver(item_message(self.items[request.seq]))

    def reads_within(self, for_s: float) -> None:
        self.run(for_s)
        assert self.has_read()

    def has_read(self) -> bool:
        return self.cache.fresh and dict(self.cache.items) == {one.seq: one for one in self.items}


@pytest.mark.parametrize("size", [0, 1, 2, 50])
def test_a_mission_is_read_at_once_and_then_left_alone(size: int) -> None:
    autopilot = Autopilot(mission(size))
    autopilot.reads_within(2.0)
    assert autopilot.acknowledged == 1  # PX4 shows on every ground station if it is missing
    assert autopilot.requests == size + 1
    autopilot.run(60.0)
    assert autopilot.requests == size + 1


@pytest.mark.parametrize("seed", range(10))
def test_lost_requests_and_replies_only_cost_time(seed: int) -> None:
    autopilot = Autopilot(mission(12), loss=0.3, seed=seed)
    autopilot.reads_within(60.0)


def test_replies_that_come_twice_and_late_change_nothing() -> None:
    items = mission(6)
    cache = MissionCache()
    cache.handle(0.0, count_message(6))
    for one in [items[0], items[0], items[3], items[1], items[0], items[5], items[4], items[2]]:
        cache.handle(0.1, item_message(one))
    assert cache.fresh
    assert [cache.items[seq] for seq in range(6)] == items
    cache.handle(0.2, item_message(item(3, 99)))
    assert cache.items[3] == items[3]


def test_an_autopilot_that_does_not_answer_is_asked_rarely() -> None:
    cache = MissionCache()
    asked = [i * TICK_S for i in range(6000) if cache.requests(i * TICK_S, 1, True)]
    assert len([t for t in asked if t < TRY_AGAIN_S]) == MAX_ATTEMPTS
    assert all(b - a >= RETRY_S - 1e-9 for a, b in itertools.pairwise(asked))
    assert 20 <= len(asked) <= 36
    assert not cache.fresh


def test_items_of_fences_and_rally_points_are_ignored() -> None:
    items = mission(3)
    cache = MissionCache()
    cache.handle(0.0, count_message(3))
    cache.handle(0.1, item_message(items[0]))
    cache.handle(0.1, item_message(item(1, 5001), mission_type=1))
    cache.handle(0.1, item_message(item(2, 5100), mission_type=2))
    assert not cache.fresh
    cache.handle(0.2, count_message(9, mission_type=1))
    cache.handle(0.3, item_message(items[1]))
    cache.handle(0.3, item_message(items[2]))
    assert [cache.items[seq] for seq in range(3)] == items


def test_integers_become_degrees_and_metres() -> None:
    cache = MissionCache()
    cache.handle(0.0, count_message(2))
    place = mavlink.MAVLink_mission_item_int_message(
        1, 191, 0, 3, 16, 0, 1, 3.0, 0, 0, 0, -353629925, 1491655123, 12.0, 0
    )
    cache.handle(0.0, sent(place))
    action = mavlink.MAVLink_mission_item_int_message(1, 191, 1, 2, 42600, 0, 1, 1, 1, 2, 0.5, 7, 8, 9.0, 0)
    cache.handle(0.0, sent(action))
    assert cache.items[0].params == pytest.approx((3.0, 0, 0, 0, -35.3629925, 149.1655123, 12.0))
    assert cache.items[1].params == (1, 1, 2, 0.5, 7, 8, 9.0)


def read(size: int = 12) -> Autopilot:
    autopilot = Autopilot(mission(size))
    autopilot.total = size - 1  # ArduPilot's count, without home
    autopilot.reads_within(10.0)
    return autopilot


def test_another_total_in_flight_is_a_change() -> None:
    autopilot = read(12)
    autopilot.items, autopilot.total = mission(15, angle_deg=-20.0), 14
    autopilot.run(0.2)
    assert not autopilot.cache.fresh
    autopilot.reads_within(2.0)


def test_an_upload_with_growing_totals_is_read_at_its_end() -> None:
    autopilot = read(12)
    before = autopilot.requests
    for total in range(20):
        autopilot.total = total
        autopilot.run(0.2)
    assert autopilot.requests == before
    assert not autopilot.cache.fresh
    autopilot.items = mission(20)
    autopilot.reads_within(2.0)
    assert autopilot.requests == before + 21


def test_the_same_total_with_another_mission_id_is_a_change() -> None:
    autopilot = Autopilot(mission(9))
    autopilot.mission_id = 419266506
    for angle_deg in (1.0, 2.0, 3.0):
        autopilot.run(2.0)  # also soon after a download
        assert autopilot.has_read()
        autopilot.items, autopilot.mission_id = mission(9, angle_deg), autopilot.mission_id + 1
    autopilot.reads_within(2.0)


def test_with_the_same_total_only_the_text_shows_a_change() -> None:
    autopilot = read(12)
    autopilot.items = mission(12, angle_deg=5.0)
    autopilot.run(30.0)
    assert autopilot.cache.fresh
    autopilot.deliver(text("Flight plan received"))
    assert not autopilot.cache.fresh
    autopilot.reads_within(2.0)


def test_another_text_shows_no_change() -> None:
    autopilot = read(12)
    for words in ("Flight plan", "Mission: 3 Scripting", "Radio Failsafe"):
        autopilot.deliver(text(words))
    assert autopilot.cache.fresh


def test_a_total_that_is_reported_after_the_reading_is_no_change() -> None:
    autopilot = Autopilot(mission(12))
    autopilot.total = 0
    autopilot.run(1.0)
    asked = autopilot.requests
    autopilot.total = 11
    autopilot.run(10.0)
    assert autopilot.requests == asked
    assert autopilot.has_read()


@pytest.mark.parametrize("ticks", range(1, 13))
def test_a_mission_that_changes_while_it_is_read_is_not_mixed(ticks: int) -> None:
    autopilot = Autopilot(mission(12, angle_deg=0.0))
    autopilot.run(ticks * TICK_S)
    autopilot.items = mission(12, angle_deg=1000.0)
    autopilot.deliver(text("Flight plan received"))
    for _ in range(200):
        autopilot.run(TICK_S)
        assert not autopilot.cache.fresh or autopilot.has_read()
    assert autopilot.has_read()


def test_a_download_by_another_client_is_read_too() -> None:
    items, cache = mission(5), MissionCache()
    cache.handle(0.0, count_message(5))
    assert cache.arriving
    for one in items:
        cache.handle(0.1, item_message(one))
    assert not cache.arriving
    assert cache.fresh
    assert cache.requests(0.2, 1, True) == []


def test_a_mission_given_beforehand_serves_until_one_was_read() -> None:
    given = mission(4, angle_deg=7.0)
    cache = MissionCache(given)
    assert cache.fresh
    assert cache.requests(0.0, 1, True) == []
    cache.handle(1.0, current(3))
    cache.handle(2.0, current(8))
    assert cache.fresh
    assert cache.items[2] == given[2]
    (request,) = cache.requests(3.0, 1, True)
    assert request.get_type() == "MISSION_REQUEST_LIST"
    items = mission(9)
    cache.handle(3.1, count_message(9))
    for one in items:
        cache.handle(3.2, item_message(one))
    assert cache.items[2] == items[2]
    cache.handle(10.0, current(12))
    assert not cache.fresh


def flying(autopilot: Autopilot, seq: int, for_s: float) -> None:
    """Fly towards item `seq` of ArduPilot's mission, which is reported five times a second."""
    for _ in range(round(for_s / 0.2)):
        message = mavlink.MAVLink_mission_current_message(seq, len(autopilot.items) - 1, 3, 1)
        autopilot.deliver(sent(message))
        for _ in range(10):
            for request in autopilot.cache.requests(autopilot.now_s, 1, True):
                autopilot.requests += 1
                if autopilot.arrives():
                    autopilot.answer(request)
            autopilot.ticks += 1


def test_an_upload_shows_in_the_number_of_items_that_is_saved_each_time() -> None:
    autopilot = read(12)
    autopilot.items = mission(12, angle_deg=5.0)
    for total in (0, 1, 2):
        value = mavlink.MAVLink_param_value_message(b"MIS_TOTAL", total, 4, 1000, 65535)
        autopilot.deliver(sent(value))
    assert not autopilot.cache.fresh
    autopilot.reads_within(3.0)
    for name, total in ((b"MIS_TOTAL", 12), (b"MIS_RESTART", 0)):
        autopilot.deliver(sent(mavlink.MAVLink_param_value_message(name, total, 4, 1000, 65535)))
    assert autopilot.cache.fresh


def test_during_an_upload_the_mission_cache_is_not_used() -> None:
    autopilot = read(12)
    flying(autopilot, 4, 1.0)
    autopilot.cache.refresh(autopilot.now_s)
    autopilot.ticks += 50
    assert autopilot.cache.requests(autopilot.now_s, 1, True)
    denied = mavlink.MAVLink_mission_ack_message(1, 191, mavlink.MAV_MISSION_DENIED, 0)
    autopilot.deliver(sent(denied))
    assert not autopilot.cache.fresh
    autopilot.reads_within(3.0)


def test_a_change_during_a_new_reading_starts_the_reading_again() -> None:
    autopilot = read(12)
    autopilot.cache.refresh(autopilot.now_s)
    autopilot.run(0.54)
    assert autopilot.cache.arriving
    assert autopilot.cache.fresh
    autopilot.items = mission(12, angle_deg=5.0)
    autopilot.run(0.2)
    assert not autopilot.cache.fresh
    autopilot.reads_within(3.0)


def test_items_that_run_soon_are_read_first() -> None:
    cache = MissionCache()
    cache.handle(0.0, current(11, 0, 6))
    cache.handle(0.1, count_message(12))
    asked = []
    for i in range(12):
        (request,) = cache.requests(0.2 + i, 1, True)
        asked.append(request.seq)
        cache.handle(0.2 + i, item_message(item(request.seq)))
    assert asked == [6, 7, 8, 9, 10, 11, 0, 1, 2, 3, 4, 5]


def test_latitudes_at_an_absolute_altitude_and_numbers_of_a_command() -> None:
    cache = MissionCache()
    cache.handle(0.0, count_message(3))
    rows = ((0, 16, -353629925, 1491655123), (1, 203, 0, 77), (2, 42702, -12, 7))
    for seq, command, x, y in rows:
        message = mavlink.MAVLink_mission_item_int_message(
            1, 191, seq, 0, command, 0, 1, 0, 0, 0, 0, x, y, 590.0, 0
        )
        cache.handle(0.0, sent(message))
    places = [cache.items[seq].params[4:6] for seq in range(3)]
    assert places == [pytest.approx((-35.3629925, 149.1655123)), (0.0, 77.0), (-12.0, 7.0)]


def test_the_end_of_a_reading_is_acknowledged_whichever_item_came_last() -> None:
    cache = MissionCache()
    assert cache.requests(1.0, 1, True)
    cache.handle(1.0, count_message(3))
    for seq in (2, 0, 1):
        assert cache.acknowledgement(1) == []
        cache.handle(1.1, item_message(item(seq)))
    (message,) = cache.acknowledgement(1)
    assert (message.get_type(), message.type) == ("MISSION_ACK", mavlink.MAV_MISSION_ACCEPTED)
    assert cache.acknowledgement(1) == []


def test_the_items_of_an_impossible_count_are_not_requested() -> None:
    cache = MissionCache()
    cache.handle(0.0, count_message(65535))
    assert not cache.arriving


def test_px4_items_are_requested_in_order_and_from_the_start_after_an_interruption() -> None:
    """PX4 sends the next item or the last one again; any other request ends the transfer."""
    items = mission(12)
    cache = MissionCache()
    dice = random.Random(4)
    cache.handle(0.0, current(12, 77, seq=7))
    next_seq: int | None = None
    broken_off = 0
    for tick in range(6000):
        for request in cache.requests(tick * TICK_S, 1):
            if dice.random() < 0.2:
                continue
            if request.get_type() == "MISSION_REQUEST_LIST":
                next_seq, answer = 0, count_message(12)
            elif next_seq is None:
                continue
            elif broken_off == 0 and request.seq == 8:
                # It forgot the transfer, for example because another ground station started one.
                next_seq, answer, broken_off = None, mavlink.MAVLink_mission_ack_message(1, 191, 1, 0), 1
            else:
                assert request.seq in (next_seq, next_seq - 1)
                next_seq, answer = request.seq + 1, item_message(items[request.seq])
            if dice.random() >= 0.2:
                cache.handle(tick * TICK_S, answer)
    assert broken_off and cache.fresh
    assert [cache.items[seq] for seq in range(12)] == items
