"""The simulated autopilot behaves like real ones in recordings."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from itertools import chain
from typing import Any

import pytest
from autopilot_world import (
    LAND,
    TAKEOFF,
    WAYPOINT,
    Peer,
    World,
    changes,
    flown,
    home,
    item,
    meeting,
    plan,
    rc_health,
    upload,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from examples import examples
from flying_vines.simulation.autopilot import AutopilotKind, FakeAutopilot, MissionRefused, RcLoss
from flying_vines.vehicle.mission.item import MissionItem


def streaming(autopilot: FakeAutopilot, for_s: float) -> World:
    """A companion has requested streams, and has received them for this time."""
    world = World(autopilot)
    world.request_streams()
    world.on(for_s)
    return world


# Quirks of ArduPilot's missions.


def test_of_two_do_items_the_second_text_comes_after_the_next_nav_item() -> None:
    world = flown(plan(TAKEOFF, WAYPOINT, (217, 1, 40), (217, 2, 10), (93, 2), LAND))
    texts = [text for text in world.companion.texts() if text.startswith("Mission: ")]
    assert texts[:6] == [
        "Mission: 1 Takeoff",
        "Mission: 2 WP",
        "Mission: 3 Scripting",
        "Mission: 5 Delay",
        "Mission: 4 Scripting",
        "Mission: 6 Land",
    ]
    first, second = (t for t, _ in world.autopilot.payload_log)
    assert second - first == pytest.approx(0.006)


@pytest.mark.parametrize(
    ("commands", "ran"),
    [
        # After the last waypoint only the first DO item runs, and none after the landing.
        ((TAKEOFF, WAYPOINT, (217, 1), (217, 2)), [3]),
        ((TAKEOFF, LAND, (217, 1)), []),
        # A payload item before the take-off runs on the ground, and twice more after the landing.
        (((217, 1, 40), TAKEOFF, LAND), [1, 1, 1]),
        # DO_JUMP runs an item again under the same number.
        ((TAKEOFF, WAYPOINT, (217, 1, 40), (93, 1), (177, 2, 2), LAND), [3, 3, 3]),
        # A DO item behind a condition is dropped if the waypoint comes first.
        ((TAKEOFF, WAYPOINT, (112, 60), (217, 1), (93, 1), LAND), []),
        ((TAKEOFF, WAYPOINT, (112, 1.5), (217, 1), (93, 4), LAND), [4]),
    ],
)
def test_which_do_items_run(commands: tuple[tuple[float, ...], ...], ran: list[int]) -> None:
    world = flown(plan(*commands), 90.0)
    assert [done.seq for _, done in world.autopilot.payload_log] == ran
    assert world.autopilot.armed is (LAND not in commands)


def test_loiter_and_back_restarts_only_the_nav_item_and_set_current_fires_a_do_item_again() -> None:
    world = flown(plan(TAKEOFF, WAYPOINT, (217, 1, 40), (93, 30), LAND), 20.0)
    assert len(world.autopilot.payload_log) == 1
    world.autopilot.set_mode("LOITER")
    world.on(1.0)
    world.companion.forget()
    world.autopilot.set_mode("AUTO")
    world.on(1.0)
    assert "Mission: 4 Delay" in world.companion.texts()
    assert len(world.autopilot.payload_log) == 1
    world.gcs.say(mavlink.MAVLink_mission_set_current_message(1, 1, 3))
    assert [done.seq for _, done in world.autopilot.payload_log] == [3, 3]


# Storage and upload


@pytest.mark.parametrize(
    ("sent", "kept"),
    [
        ((217, 1.9, 1.5, -2.25, 300.0, 9.0, 9.0, 9.0), (1.0, 1.5, -2.25, 300.0, 0.0, 0.0, 0.0)),
        ((217, 70000.0, 0.1), (4464.0, 0.10000000149011612, 0.0, 0.0, 0.0, 0.0, 0.0)),
        ((217, -1.0), (65535.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
        ((211, 257.0, 1.7, 5.0), (1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
        ((42600, 1.0, 1.0, 2.5, 0.5), (1.0, 1.0, 2.5, 0.5, 0.0, 0.0, 0.0)),
        ((42702, 5.0, 4.0, 0.1, 2.0, -3.0, 7.0, 9.0), (5.0, 4.0, 0.0999755859375, 2.0, -3.0, 7.0, 0.0)),
        ((183, 9.0, 1900.0), (9.0, 1900.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
    ],
)
def test_params_after_ardupilots_storage(sent: tuple[float, ...], kept: tuple[float, ...]) -> None:
    stored = FakeAutopilot("ardupilot", mission=plan(sent)).items[1]
    assert stored.params == kept
    assert stored.frame == 0


@pytest.mark.parametrize(
    ("kind", "refused", "result"),
    [
        ("ardupilot", item(1, 31010, 1.0), 3),
        ("ardupilot", item(1, 187, 0.5), 3),
        ("ardupilot", item(1, 217, 1.0, math.nan), 7),
        ("ardupilot", item(1, 217, 1.0, 1.0, math.inf), 8),
        ("px4", item(1, 217, 1.0, frame=2), 3),
        ("px4", item(1, 31000, 1.0, frame=2), 3),
        ("px4", item(1, 187, 0.5, frame=3), 2),
    ],
)
def test_a_refused_item_ends_the_upload(kind: AutopilotKind, refused: MissionItem, result: int) -> None:
    with pytest.raises(MissionRefused):
        FakeAutopilot(kind, mission=[home(), refused])
    good = item(2, 16, 0.0, 0.0, 0.0, 0.0, 47.0, 8.0, 5.0)
    old = [home(), item(1, 22), item(2, 22)] if kind == "ardupilot" else [item(0, 22), item(1, 22)]
    first = home() if kind == "ardupilot" else item(0, 16, 0, 0, 0, 0, 47, 8, 5)
    world = World(FakeAutopilot(kind, mission=old), upload([first, refused, good]))
    world.gcs.say(mavlink.MAVLink_mission_count_message(1, 1, 3))
    world.on(1.0)
    assert [message.type for message in world.gcs.of("MISSION_ACK")] == [result]
    assert [stored.command for stored in world.autopilot.items] == [stored.command for stored in old]


def test_a_refused_upload_to_ardupilot_leaves_a_mixed_mission() -> None:
    new = plan((217, 1), (31010,), LAND)
    world = World(FakeAutopilot("ardupilot", mission=plan(TAKEOFF, WAYPOINT, LAND)), upload(new))
    world.gcs.say(mavlink.MAVLink_mission_count_message(1, 1, len(new)))
    world.on(1.0)
    assert [stored.command for stored in world.autopilot.items] == [16, 217, 16, 21]


def test_an_upload_is_asked_for_again_and_then_given_up() -> None:
    world = World(FakeAutopilot("ardupilot"))
    world.gcs.say(mavlink.MAVLink_mission_count_message(1, 1, 3))
    world.on(20.0)
    assert len(world.gcs.of("MISSION_REQUEST")) == 8
    assert [message.type for message in world.gcs.of("MISSION_ACK")] == [15]


def item_message(seq: int, command: int) -> Any:
    return mavlink.MAVLink_mission_item_int_message(1, 1, seq, 3, command, 0, 1, 0, 0, 0, 0, 0, 0, 10)


@pytest.mark.parametrize(("kind", "refused"), [("ardupilot", 14), ("px4", 1)])
def test_another_sender_does_not_join_an_upload(kind: AutopilotKind, refused: int) -> None:
    world = World(FakeAutopilot(kind))
    world.companion.hello()
    world.gcs.say(mavlink.MAVLink_mission_count_message(1, 1, 2))
    world.companion.say(mavlink.MAVLink_mission_count_message(1, 1, 5))
    world.on(0.1)
    assert [ack.type for ack in world.companion.of("MISSION_ACK")] == [refused]
    world.companion.say(item_message(0, 21))
    world.on(0.1)
    # ArduPilot answers where the upload came from.
    denied = [ack.type for ack in world.gcs.of("MISSION_ACK") if ack.target_component == 191]
    assert denied == ([14] if kind == "ardupilot" else [])
    assert ("REJ. MIS ITEM: partner id mismatch\t" in world.companion.texts()) == (kind == "px4")
    for seq in range(2):
        world.gcs.say(item_message(seq, 22))
        world.on(0.1)
    assert world.gcs.of("MISSION_ACK")[-1].type == 0
    assert [stored.command for stored in world.autopilot.items][1:] == [22]


@pytest.mark.parametrize(("kind", "takes"), [("ardupilot", True), ("px4", False)])
def test_only_ardupilot_takes_an_item_from_another_link(kind: AutopilotKind, takes: bool) -> None:
    world = World(FakeAutopilot(kind))
    world.companion.hello()
    world.gcs.say(mavlink.MAVLink_mission_count_message(1, 1, 1))
    Peer(world, "companion", 255, 190, 6).say(item_message(0, 22))
    world.on(0.5)
    assert [ack.type for ack in world.gcs.of("MISSION_ACK")] == ([0] if takes else [])


# PX4


def test_a_burst_of_more_than_eight_items_loses_the_first() -> None:
    burst = [item(seq, 187, seq / 100, frame=2) for seq in range(1, 11)]
    mission = [item(0, 22, 0, 0, 0, 0, 0, 0, 5), *burst, item(11, 93, 20, frame=2)]
    world = World(FakeAutopilot("px4", mission=mission))
    world.companion.hello()
    world.autopilot.start_mission()
    world.on(8.0)
    first = [m for m in world.companion.of("COMMAND_LONG") if m.command == 187 and m.confirmation == 0]
    assert [round(message.param1 * 100) for message in first] == list(range(3, 11))
    assert changes(message.seq for message in world.companion.of("MISSION_ITEM_REACHED")) == [10]


def test_px4_stops_rc_channels_when_rc_is_lost_and_flies_on() -> None:
    world = World(FakeAutopilot("px4"))
    world.request_streams()
    world.autopilot.takeoff(30.0)
    world.on(2.0)
    assert len(world.companion.of("RC_CHANNELS")) == 20
    world.companion.forget()
    world.autopilot.lose_rc()
    world.on(3.0)
    assert world.companion.of("RC_CHANNELS") == []
    assert world.autopilot.mode.name == "TAKEOFF"
    world.autopilot.set_rc(9, 2000)
    world.autopilot.return_rc()
    world.on(0.1)
    assert world.companion.of("RC_CHANNELS")[0].chan9_raw == 2000


def px4_plan(*commands: tuple[float, ...]) -> list[MissionItem]:
    """Take-off, and then the given (command, param1, …) in order."""
    takeoff = item(0, 22, 0, 0, 0, 0, 0, 0, 5)
    return [takeoff, *(item(seq, int(c[0]), *c[1:], frame=2) for seq, c in enumerate(commands, start=1))]


def commands_187(world: World) -> list[tuple[float, int]]:
    """The values for the actuator, and the number of the copy."""
    asked = [message for message in world.companion.of("COMMAND_LONG") if message.command == 187]
    return [(round(message.param1, 1), message.confirmation) for message in asked]


def test_px4_takes_an_acknowledgement_for_the_oldest_command_of_that_number() -> None:
    world = World(FakeAutopilot("px4", mission=px4_plan((187, 0.1), (187, 0.2), (93, 20))))
    world.companion.hello()
    world.autopilot.start_mission()
    while len(commands_187(world)) < 2:
        world.on(0.1)
    acknowledge = mavlink.MAVLink_command_ack_message(187, 0, 0, 0, 1, 1)
    world.companion.say(acknowledge)
    world.companion.say(acknowledge)
    world.on(1.1)
    assert commands_187(world)[2:] == [(0.2, 1)], "both were acknowledged, but only one is known to be"
    # One acknowledgement too many: the other command is then not repeated.
    world.companion.say(acknowledge)
    world.on(3.0)
    assert len(commands_187(world)) == 3


def test_px4_reports_an_old_current_item_after_a_jump() -> None:
    world = World(FakeAutopilot("px4", mission=px4_plan((93, 3), (93, 3), (93, 3))))
    world.request_streams()
    world.autopilot.start_mission()
    while not any(message.seq == 1 for message in world.companion.of("MISSION_CURRENT")):
        world.on(0.1)
    world.autopilot.set_current(3)
    world.on(2.0)
    assert world.companion.of("MISSION_CURRENT")[-1].seq == 1
    world.on(2.0)
    assert world.companion.of("MISSION_CURRENT")[-1].seq == 3


def test_ardupilot_does_not_report_another_mission_of_the_same_length() -> None:
    world = World(FakeAutopilot("ardupilot", mission=plan(TAKEOFF, (217, 1, 40), (93, 9), LAND)))
    world.gcs.hello()
    world.request_streams()
    world.on(2.0)  # The count of the seconds is sent every 31 s.
    before = len(world.companion.received)
    world.autopilot.replace_mission(plan(TAKEOFF, (217, 1, 11), (93, 9), LAND))
    world.on(1.0)
    told = {message.get_type() for _, message in world.companion.received[before:]}
    assert not told & {"PARAM_VALUE", "STATUSTEXT", "MISSION_ACK"}
    assert world.gcs.texts() == ["Flight plan received"]
    assert world.autopilot.items[2].params[1] == 11


def test_px4_reports_another_mission_by_its_id() -> None:
    world = World(FakeAutopilot("px4"))
    world.request_streams()
    world.on(1.0)
    for opening in (0.4, 0.1):
        world.autopilot.replace_mission(px4_plan((187, opening), (93, 9)))
        world.on(1.0)
    payloads = [bytes(m.get_msgbuf())[10:-2] for m in world.companion.of("MISSION_CURRENT")]
    ids = changes(payload.ljust(18, b"\0")[6:10] for payload in payloads)
    assert ids[0] == bytes(4) and len(set(ids)) == 3
    assert world.autopilot.items[1].params[0] == pytest.approx(0.1)


# Links


@pytest.mark.parametrize("both_ways", [False, True])
def test_a_stalled_link_delivers_all_at_once(both_ways: bool) -> None:
    world = streaming(FakeAutopilot("ardupilot"), 1.0)
    world.companion.forget()
    world.autopilot.stall(3.0, both_ways=both_ways)
    world.on(1.0)
    world.companion.command(183, 9, 1900)
    world.on(1.9)
    assert world.companion.received == []
    assert bool(world.autopilot.performed) is not both_ways
    world.on(0.2)
    boots_ms = [message.time_boot_ms for message in world.companion.of("RC_CHANNELS")]
    assert len(boots_ms) == pytest.approx(31, abs=1)
    assert boots_ms == sorted(boots_ms)
    assert len(world.autopilot.performed) == 1
    assert [message.result for message in world.companion.of("COMMAND_ACK")] == [0]


@pytest.mark.parametrize("both_ways", [False, True])
def test_a_second_stall_says_anew_which_ways_are_stalled(both_ways: bool) -> None:
    world = streaming(FakeAutopilot("ardupilot"), 1.0)
    world.autopilot.stall(1.0, both_ways=not both_ways)
    world.autopilot.stall(3.0, both_ways=both_ways)
    world.companion.command(183, 9, 1900)
    world.on(2.0)
    assert bool(world.autopilot.performed) is not both_ways


@pytest.mark.parametrize(
    ("kind", "kinds"), [("ardupilot", {"HEARTBEAT", "TIMESYNC"}), ("px4", {"HEARTBEAT"})]
)
def test_a_link_that_never_sent_gets_little(kind: AutopilotKind, kinds: set[str]) -> None:
    world = World(FakeAutopilot(kind))
    world.gcs.hello()
    world.autopilot.takeoff(5.0)
    world.gcs.say(mavlink.MAVLink_named_value_float_message(1, b"X", 1.0))
    world.on(20.5)
    assert {message.get_type() for _, message in world.companion.received} == kinds
    assert len(world.companion.of("HEARTBEAT")) in (21, 22)


def test_ardupilot_executes_a_command_for_an_unknown_component_itself() -> None:
    world = World(FakeAutopilot("ardupilot"))
    world.gcs.hello()
    world.gcs.command(183, 9, 1900, to=(1, 191))
    world.on(0.1)
    ack = world.gcs.of("COMMAND_ACK")[0]
    assert (ack.get_srcComponent(), ack.result) == (1, 0)
    assert [command for _, command in world.autopilot.performed] == [183]

    world.companion.hello()
    world.gcs.command(183, 9, 1900, to=(1, 191))
    world.on(0.1)
    assert len(world.autopilot.performed) == 1
    assert [message.command for message in world.companion.of("COMMAND_LONG")] == [183]
    assert len(world.gcs.of("COMMAND_ACK")) == 1


def test_px4_ignores_a_command_for_an_unknown_component() -> None:
    world = World(FakeAutopilot("px4"))
    world.gcs.hello()
    world.gcs.command(187, 0.5, to=(1, 191))
    world.on(0.1)
    assert world.gcs.of("COMMAND_ACK") == []
    assert world.autopilot.performed == []


@pytest.mark.parametrize(
    ("to", "arrives"),
    [
        ((255, 190), True),
        ((255, 0), True),
        ((255, 1), True),
        ((0, 0), True),
        ((254, 190), False),
        ((1, 0), False),
        ((1, 1), False),
    ],
)
def test_which_acknowledgements_reach_the_ground_station(to: tuple[int, int], arrives: bool) -> None:
    world = meeting(FakeAutopilot("ardupilot"))
    world.companion.say(mavlink.MAVLink_command_ack_message(31010, 0, 0, 0, *to))
    world.on(0.1)
    assert bool(world.gcs.of("COMMAND_ACK")) is arrives


@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
def test_named_values_and_texts_reach_the_ground_station_unchanged(kind: AutopilotKind) -> None:
    world = meeting(FakeAutopilot(kind))
    world.companion.say(mavlink.MAVLink_named_value_float_message(1, b"VINE_BEND", 40.0))
    world.companion.say(mavlink.MAVLink_statustext_message(6, b"vine bent"))
    world.on(0.1)
    assert [message.get_srcComponent() for message in world.gcs.of("NAMED_VALUE_FLOAT", "STATUSTEXT")] == [
        191,
        191,
    ]
    assert any(message.get_srcSystem() == 255 for message in world.companion.of("HEARTBEAT")) is False
    world.gcs.hello()
    world.on(0.1)
    assert any(message.get_srcSystem() == 255 for message in world.companion.of("HEARTBEAT"))


def test_a_stream_has_the_rate_asked_for_and_stops() -> None:
    world = streaming(FakeAutopilot("ardupilot"), 10.0)
    assert {name: len(world.companion.of(name)) for name in ("RC_CHANNELS", "SYS_STATUS", "ATTITUDE")} == {
        "RC_CHANNELS": 100,
        "SYS_STATUS": 20,
        "ATTITUDE": 50,
    }
    world.companion.command(511, 65, -1)
    world.companion.forget()
    world.on(1.0)
    assert world.companion.of("RC_CHANNELS") == []
    world.gcs.say(mavlink.MAVLink_request_data_stream_message(1, 1, 3, 4, 1))
    world.on(1.0)
    assert len(world.gcs.of("RC_CHANNELS")) == 4
    assert world.companion.of("RC_CHANNELS") == []


def test_a_message_is_sent_once_on_request_and_an_unknown_one_refused() -> None:
    world = World(FakeAutopilot("ardupilot"))
    world.companion.command(512, 148)
    world.companion.command(511, 12345, 1e6)
    world.companion.command(31010, 1)
    world.on(0.1)
    assert [message.result for message in world.companion.of("COMMAND_ACK")] == [0, 2, 3]
    assert len(world.companion.of("AUTOPILOT_VERSION")) == 1
    assert world.companion.texts() == ["No ap_message for mavlink id (12345)"]


def test_the_sequence_counts_up_per_link_without_a_gap() -> None:
    world = streaming(FakeAutopilot("ardupilot"), 30.0)
    sequence = [frame[4] for frame in world.companion.frames]
    assert len(sequence) > 600
    assert sequence == [index % 256 for index in range(len(sequence))]


def test_a_reboot_sends_nothing_and_then_knows_no_link() -> None:
    world = World(FakeAutopilot("ardupilot", mission=plan(TAKEOFF, LAND)))
    world.request_streams()
    world.on(5.0)
    before_ms = world.companion.of("RC_CHANNELS")[-1].time_boot_ms
    world.companion.forget()
    world.autopilot.reboot()
    world.on(1.2)
    assert world.companion.frames == []
    world.on(5.0)
    assert world.companion.frames[0][4] == 0
    assert {message.get_type() for _, message in world.companion.received} == {"HEARTBEAT"}
    world.gcs.command(183, 9, 1900, to=(1, 191))
    assert len(world.autopilot.performed) == 1, "the companion's route is forgotten"
    world.request_streams()
    world.on(1.0)
    assert world.companion.of("RC_CHANNELS")[0].time_boot_ms < before_ms
    assert len(world.autopilot.items) == 3


def test_an_upload_right_after_boot_finds_no_space_and_ready_is_reported_later() -> None:
    world = World(FakeAutopilot("ardupilot"))
    world.autopilot.reboot()
    world.on(1.3)
    world.gcs.say(mavlink.MAVLink_mission_count_message(1, 1, 2))
    world.on(2.0)
    assert [message.type for message in world.gcs.of("MISSION_ACK")] == [4]
    assert world.gcs.texts() == ["ArduPilot Ready"]


def test_interrupted_links_carry_nothing_either_way_and_the_gap_shows() -> None:
    world = streaming(FakeAutopilot("ardupilot"), 1.0)
    last = world.companion.frames[-1][4]
    world.companion.forget()
    world.autopilot.mute(3.0)
    world.companion.command(183, 9, 1900)
    world.on(2.9)
    assert world.companion.frames == []
    world.on(1.0)
    assert world.companion.of("COMMAND_ACK") == world.autopilot.performed == []
    assert (world.companion.frames[0][4] - last) % 256 > 20


# RC and stimuli


def test_without_a_receiver_since_boot_there_are_no_channels() -> None:
    world = streaming(FakeAutopilot("ardupilot", rc_present=False), 1.0)
    channels = world.companion.of("RC_CHANNELS")[0]
    assert (channels.chancount, channels.chan9_raw) == (0, 0)
    assert not rc_health(world.companion.of("SYS_STATUS")[0])
    world.autopilot.set_rc(9, 2000)
    world.autopilot.return_rc()
    world.on(1.0)
    assert world.companion.of("RC_CHANNELS")[-1].chan9_raw == 2000
    assert rc_health(world.companion.of("SYS_STATUS")[-1])


@pytest.mark.parametrize(
    ("parameters", "how", "told"),
    [
        ({}, "frozen", True),
        ({}, "jump", True),
        ({"RC_FS_TIMEOUT": 8}, "frozen", False),
        ({"RC_FS_TIMEOUT": 8}, "jump", True),
        ({"RC_OPTIONS": 4}, "frozen", False),
    ],
)
def test_parameters_of_ardupilot_hide_a_loss(parameters: dict[str, float], how: RcLoss, told: bool) -> None:
    world = World(FakeAutopilot("ardupilot", parameters=parameters))
    world.request_streams()
    world.autopilot.lose_rc(how)
    world.on(3.0)
    assert world.autopilot.rc.reports_loss is told
    assert bool(world.companion.texts()) is told
    assert rc_health(world.companion.of("SYS_STATUS")[-1]) is not told


def test_ardupilot_may_ignore_overrides() -> None:
    world = World(FakeAutopilot("ardupilot", parameters={"RC_OPTIONS": 2}))
    world.request_streams()
    world.gcs.say(mavlink.MAVLink_rc_channels_override_message(1, 1, *(65535,) * 8, 2000, *(0,) * 9))
    world.on(1.0)
    assert {message.chan9_raw for message in world.companion.of("RC_CHANNELS")} == {1000}


def test_a_joystick_gives_no_channels_also_after_a_loss() -> None:
    world = World(FakeAutopilot("px4", receiver="joystick"))
    world.request_streams()
    world.autopilot.lose_rc()
    world.autopilot.return_rc()
    world.on(1.0)
    assert world.companion.of("RC_CHANNELS") == []


def test_stimuli_that_make_no_sense_are_refused() -> None:
    autopilot = FakeAutopilot("ardupilot")
    stimuli: list[Callable[[], None]] = [
        lambda: autopilot.set_mode("SIDEWAYS"),
        lambda: autopilot.set_rc(17, 1500),
        lambda: autopilot.set_rc(1, -1),
        lambda: autopilot.set_current(1),
        lambda: autopilot.lose_rc("silent"),
        lambda: autopilot.parameters.change("NONSENSE", 1.0),
    ]
    for nonsense in stimuli:
        with pytest.raises(ValueError):
            nonsense()
    with pytest.raises(ValueError, match="sbus"):
        FakeAutopilot("ardupilot", receiver="sbus")


def test_auto_without_a_mission_is_refused() -> None:
    world = World(FakeAutopilot("ardupilot"))
    world.gcs.command(176, 1, 3)
    world.on(0.1)
    assert world.gcs.of("COMMAND_ACK")[0].result == 4
    assert world.autopilot.mode.name == "STABILIZE"


@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
def test_a_ground_station_flies_it_by_command(kind: AutopilotKind) -> None:
    world = World(FakeAutopilot(kind))
    world.gcs.hello()
    if kind == "ardupilot":
        world.gcs.command(176, 1, 4)
    world.gcs.command(400, 1)
    world.gcs.command(22, 0, 0, 0, 0, 0, 0, 10)
    world.on(8.0)
    assert world.autopilot.flight.height_m == pytest.approx(10.0)
    world.gcs.command(21)
    world.on(15.0)
    assert not world.autopilot.armed
    assert {message.result for message in world.gcs.of("COMMAND_ACK")} == {0}


def test_time_may_be_cut_in_any_way() -> None:
    def run(cuts: Sequence[float]) -> list[tuple[str, bytes]]:
        autopilot = FakeAutopilot(
            "ardupilot", mission=plan(TAKEOFF, WAYPOINT, (217, 1), (217, 2), (93, 1), LAND)
        )
        frames = autopilot.advance(100.0)
        hello = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
        autopilot.receive(100.0, "companion", hello.pack(mavlink.MAVLink(None, 1, 191)))
        autopilot.start_mission()
        for cut in cuts:
            frames += autopilot.advance(100.0 + cut)
        return frames

    randomly = sorted(random.Random(7).uniform(0.0, 40.0) for _ in range(300))
    assert run([40.0]) == run([*randomly, 40.0])


# Any input.


KINDS = st.sampled_from(["ardupilot", "px4"])
FLOATS = st.floats(width=32)
UINT16 = st.integers(0, 65535)


@settings(max_examples=examples(150), deadline=None)
@given(KINDS, st.lists(st.binary(max_size=300), max_size=5))
def test_random_bytes_raise_no_error(kind: AutopilotKind, chunks: list[bytes]) -> None:
    autopilot = FakeAutopilot(kind)
    for t, chunk in enumerate(chunks):
        autopilot.receive(t / 10, "companion", chunk)
    autopilot.advance(1.0)


def valid_frames() -> bytes:
    peer = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
    messages = (
        mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3),
        mavlink.MAVLink_command_long_message(1, 1, 511, 0, 65, 1e5, 0, 0, 0, 0, 0),
        mavlink.MAVLink_mission_count_message(1, 1, 3),
        mavlink.MAVLink_mission_item_int_message(1, 1, 0, 3, 16, 0, 1, 0, 0, 0, 0, 10, 20, 30),
        mavlink.MAVLink_statustext_message(6, b"hello"),
    )
    return b"".join(bytes(message.pack(peer)) for message in messages)


@settings(max_examples=examples(150), deadline=None)
@given(KINDS, st.lists(st.tuples(st.integers(0, 200), st.integers(0, 255)), max_size=8))
def test_damaged_frames_raise_no_error(kind: AutopilotKind, damage: list[tuple[int, int]]) -> None:
    frames = bytearray(valid_frames())
    for at, byte in damage:
        frames[at % len(frames)] = byte
    autopilot = FakeAutopilot(kind)
    autopilot.receive(0.0, "companion", bytes(frames))
    autopilot.advance(1.0)


BYTES = st.integers(0, 255)
COMMANDS = st.sampled_from([16, 20, 21, 22, 93, 112, 115, 176, 177, 183, 187, 211, 217, 224, 300, 400, 511])
MORE_COMMANDS = st.one_of(COMMANDS, st.sampled_from([512, 246, 530, 2000, 42600, 42702]), UINT16)
INT32 = st.integers(-(2**31), 2**31 - 1)
ADDRESS = st.sampled_from([(0, 0), (1, 0), (1, 1), (1, 191), (255, 190)])
SEVEN = st.tuples(FLOATS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS)
PARAMETERS = st.sampled_from([b"", b"_HASH_CHECK", b"SYSID_MYGCS", b"MAV_1_FORWARD", b"RC_OVERRIDE_TIME"])
FLAT = st.tuples
"""Fields of a message in order; a tuple among them is several fields."""
MESSAGES: dict[Any, st.SearchStrategy[tuple[Any, ...]]] = {
    mavlink.MAVLink_command_long_message: FLAT(ADDRESS, MORE_COMMANDS, BYTES, SEVEN),
    mavlink.MAVLink_command_int_message: FLAT(
        ADDRESS, st.just(3), MORE_COMMANDS, st.just((0, 0)), *[FLOATS] * 4, INT32, INT32, FLOATS
    ),
    mavlink.MAVLink_mission_item_message: FLAT(
        ADDRESS, st.integers(0, 3), st.integers(0, 12), MORE_COMMANDS, st.just((0, 1)), SEVEN
    ),
    mavlink.MAVLink_mission_count_message: FLAT(ADDRESS, st.integers(0, 4), BYTES),
    mavlink.MAVLink_mission_request_message: FLAT(ADDRESS, st.integers(0, 5)),
    mavlink.MAVLink_request_data_stream_message: FLAT(ADDRESS, BYTES, UINT16, st.just(1)),
    mavlink.MAVLink_param_set_message: FLAT(ADDRESS, PARAMETERS, FLOATS, BYTES),
    mavlink.MAVLink_param_request_read_message: FLAT(ADDRESS, st.just(b"X"), st.integers(-5, 40)),
    mavlink.MAVLink_param_request_list_message: FLAT(ADDRESS),
    mavlink.MAVLink_rc_channels_override_message: FLAT(ADDRESS, *[UINT16] * 18),
    mavlink.MAVLink_file_transfer_protocol_message: FLAT(
        st.just(0), ADDRESS, st.binary(min_size=251, max_size=251)
    ),
    mavlink.MAVLink_named_value_float_message: FLAT(st.just(0), st.binary(max_size=10), FLOATS),
    mavlink.MAVLink_set_mode_message: FLAT(st.just((1, 1)), st.sampled_from([3, 4, 6, 9, 67371008, 0])),
}


@st.composite
def strange_messages(draw: st.DrawFn) -> Any:
    make = draw(st.sampled_from(list(MESSAGES)))
    parts = (part if isinstance(part, tuple) else (part,) for part in draw(MESSAGES[make]))
    return make(*chain.from_iterable(parts))


@settings(max_examples=examples(250), deadline=None)
@given(KINDS, st.lists(strange_messages(), max_size=8), st.lists(SEVEN, min_size=1, max_size=3), COMMANDS)
def test_invalid_messages_raise_no_error(
    kind: AutopilotKind, messages: list[Any], uploaded: list[tuple[float, ...]], command: int
) -> None:
    autopilot = FakeAutopilot(kind)
    peer = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    frame = 2 if kind == "px4" and command > 90 else 3
    messages = [
        mavlink.MAVLink_mission_count_message(1, 1, len(uploaded)),
        *(
            mavlink.MAVLink_mission_item_message(1, 1, seq, frame, command, 0, 1, *params)
            for seq, params in enumerate(uploaded)
        ),
        *messages,
    ]
    for index, message in enumerate(messages):
        autopilot.receive(index / 10, "gcs", bytes(message.pack(peer)))
        for seq in range(2):
            ask = mavlink.MAVLink_mission_request_int_message(1, 1, seq)
            autopilot.receive(index / 10, "gcs", bytes(ask.pack(peer)))
        if index == len(uploaded):
            autopilot.start_mission()
    autopilot.advance(5.0)


@pytest.mark.parametrize(("kind", "given"), [("ardupilot", [0, 5, 5, 2]), ("px4", [0])])
def test_px4_gives_items_in_turn_only_and_ardupilot_any(kind: AutopilotKind, given: list[int]) -> None:
    world = World(FakeAutopilot(kind, mission=[item(seq, 16, 0, 0, 0, 0, 47, 8, 10) for seq in range(8)]))
    world.companion.hello()
    world.companion.say(mavlink.MAVLink_mission_request_list_message(1, 1))
    for seq in (0, 5, 5, 2):
        world.companion.say(mavlink.MAVLink_mission_request_int_message(1, 1, seq))
    world.on(0.5)
    assert [message.seq for message in world.companion.of("MISSION_ITEM_INT")] == given
    assert [ack.type for ack in world.companion.of("MISSION_ACK")] == ([] if kind == "ardupilot" else [1])
