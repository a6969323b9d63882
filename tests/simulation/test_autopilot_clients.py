"""The simulated autopilot for real clients: parameters, files, overrides, forwarding, signing, missions."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from autopilot_world import LAND, TAKEOFF, World, changes, meeting, parameter_bytes, plan
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.simulation.autopilot import AutopilotKind, FakeAutopilot
from missions.home import SIMULATOR_HOME

KEY = bytes(range(32))


def as_integer(message: Any) -> int:
    (value,) = struct.unpack("<i", parameter_bytes(message))
    return int(value)


def set_parameter(world: World, name: str, value: float, kind: int) -> None:
    world.gcs.say(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, kind))
    world.on(0.05)


# Parameters


@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
def test_all_parameters_are_listed_once_and_can_be_read_by_index_and_name(kind: AutopilotKind) -> None:
    world = World(FakeAutopilot(kind))
    world.gcs.say(mavlink.MAVLink_param_request_list_message(1, 1))
    world.on(0.5)
    values = [m for m in world.gcs.of("PARAM_VALUE") if m.param_index != 65535]
    count = values[0].param_count
    assert [message.param_index for message in values] == list(range(count))
    assert len({message.param_id for message in values}) == count
    world.gcs.forget()
    for value in values:
        world.gcs.say(mavlink.MAVLink_param_request_read_message(1, 1, b"", value.param_index))
        world.gcs.say(mavlink.MAVLink_param_request_read_message(1, 1, value.param_id.encode(), -1))
    world.on(0.1)
    again = [(m.param_id, parameter_bytes(m)) for m in world.gcs.of("PARAM_VALUE")]
    assert again[::2] == again[1::2] == [(m.param_id, parameter_bytes(m)) for m in values]


def test_ardupilot_sends_integers_as_floats_and_px4_sends_their_bytes() -> None:
    ardupilot, px4 = World(FakeAutopilot("ardupilot")), World(FakeAutopilot("px4"))
    set_parameter(ardupilot, "SYSID_MYGCS", 250.0, 4)
    assert [m.param_value for m in ardupilot.gcs.of("PARAM_VALUE")] == [250.0]
    assert ardupilot.autopilot.parameters["SYSID_MYGCS"] == 250.0
    set_parameter(px4, "NAV_RCL_ACT", struct.unpack("<f", struct.pack("<i", -1))[0], 6)
    assert [as_integer(m) for m in px4.gcs.of("PARAM_VALUE")] == [-1]
    assert px4.autopilot.parameters["NAV_RCL_ACT"] == -1.0


def test_a_change_is_sent_on_every_link_but_the_system_id_stays() -> None:
    world = World(FakeAutopilot("ardupilot"))
    world.companion.hello()
    set_parameter(world, "SCR_ENABLE", 1.0, 2)
    set_parameter(world, "SYSID_THISMAV", 7.0, 4)
    sent = [(m.param_id, m.param_value) for m in world.companion.of("PARAM_VALUE")]
    assert sent == [("SCR_ENABLE", 1.0), ("SYSID_THISMAV", 1.0)]
    set_parameter(world, "NO_SUCH", 1.0, 9)
    assert len(world.gcs.of("PARAM_VALUE")) == 2
    world = World(FakeAutopilot("px4"))
    world.gcs.hello()
    set_parameter(world, "NO_SUCH", 1.0, 9)
    assert world.gcs.texts() == ["[pm] unknown param: NO_SUCH"]


def test_px4_starts_the_list_with_a_hash_and_stops_when_it_is_sent_back() -> None:
    world = World(FakeAutopilot("px4"))
    world.gcs.say(mavlink.MAVLink_param_request_list_message(1, 1))
    world.on(0.035)
    first = world.gcs.of("PARAM_VALUE")[0]
    assert (first.param_id, first.param_index) == ("_HASH_CHECK", 65535)
    set_parameter(world, "_HASH_CHECK", first.param_value, 5)
    world.on(0.5)
    assert 1 < len(world.gcs.of("PARAM_VALUE")) <= 5
    world.gcs.forget()
    hashes = []
    for value in (2, 3):
        set_parameter(world, "NAV_RCL_ACT", struct.unpack("<f", struct.pack("<i", value))[0], 6)
        world.gcs.say(mavlink.MAVLink_param_request_read_message(1, 1, b"_HASH_CHECK", -1))
        world.on(0.05)
        hashes.append(as_integer(world.gcs.of("PARAM_VALUE")[-1]))
    assert hashes[0] == as_integer(first) != hashes[1]


@pytest.mark.parametrize(("operation", "error"), [(4, 10), (15, 10), (3, 6), (200, 7)])
def test_a_request_for_a_file_is_refused_at_once(operation: int, error: int) -> None:
    world = World(FakeAutopilot("ardupilot"))
    request = struct.pack("<HBBBBBxI", 65535, 3, operation, 5, 0, 0, 0) + b"@PARAM/param.pck"
    message = mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, request.ljust(251, b"\0"))
    world.gcs.say(message)
    world.on(0.05)
    (answer,) = world.gcs.of("FILE_TRANSFER_PROTOCOL")
    assert (answer.target_system, answer.target_component) == (255, 190)
    assert list(answer.payload[:7]) == [0, 0, 3, 129, 1, operation, 0]
    assert answer.payload[12] == error
    world.gcs.forget()
    world.gcs.say(answer)
    world.on(0.05)
    assert world.gcs.of("FILE_TRANSFER_PROTOCOL") == []


# RC overrides


def override(world: World, ch9_us: int) -> None:
    channels_us = (*(65535,) * 8, ch9_us, *(0,) * 9)
    world.gcs.say(mavlink.MAVLink_rc_channels_override_message(1, 1, *channels_us))


def channel_9(world: World) -> list[int]:
    return changes(message.chan9_raw for message in world.companion.of("RC_CHANNELS"))


def test_ardupilot_accepts_overrides_of_its_ground_station_only_for_3_s() -> None:
    world = World(FakeAutopilot("ardupilot"))
    world.request_streams()
    world.on(0.5)
    channels_us = (*(65535,) * 8, 2000, *(0,) * 9)
    world.companion.say(mavlink.MAVLink_rc_channels_override_message(1, 1, *channels_us))
    world.on(0.5)
    assert channel_9(world) == [1000]
    override(world, 2000)
    world.on(1.0)
    override(world, 0)
    override(world, 65535)
    world.on(2.8)
    assert channel_9(world) == [1000, 2000]
    world.on(0.5)
    assert channel_9(world) == [1000, 2000, 1000]
    override(world, 1800)
    world.on(0.5)
    override(world, 65534)
    world.on(0.3)
    assert channel_9(world) == [1000, 2000, 1000, 1800, 1000]
    assert {message.chan1_raw for message in world.companion.of("RC_CHANNELS")} == {1500}


def test_overrides_clear_the_failsafe_of_a_lost_transmitter() -> None:
    world = World(FakeAutopilot("ardupilot"))
    world.request_streams()
    world.autopilot.lose_rc()
    world.on(2.0)
    override(world, 2000)
    world.on(1.0)
    assert world.companion.texts() == ["Radio Failsafe", "Radio Failsafe Cleared"]
    world.on(3.0)
    assert world.companion.texts()[2:] == ["Radio Failsafe"]


# Forwarding


def test_px4_forwards_only_two_messages_of_a_burst() -> None:
    for kind, forwarded in (("px4", 2), ("ardupilot", 6)):
        world = meeting(FakeAutopilot(kind))  # type: ignore[arg-type]
        for number in range(6):
            world.companion.say(mavlink.MAVLink_statustext_message(6, b"%d" % number))
        world.on(0.1)
        assert world.gcs.texts() == [str(number) for number in range(forwarded)]
        for number in range(6):
            world.companion.say(mavlink.MAVLink_statustext_message(6, b"%d" % number))
            world.on(0.02)
        assert len(world.gcs.texts()) == forwarded + 6


def test_px4_forwards_for_a_companion_only_if_set_at_boot() -> None:
    world = World(FakeAutopilot("px4", parameters={"MAV_1_FORWARD": 0}))

    def received_by_gcs() -> int:
        world.gcs.hello()
        world.companion.hello()
        world.on(0.05)
        world.companion.say(mavlink.MAVLink_statustext_message(6, b"hello"))
        world.on(0.1)
        return len([m for _, m in world.gcs.received if m.get_srcComponent() == 191])

    assert received_by_gcs() == 0
    set_parameter(world, "MAV_1_FORWARD", struct.unpack("<f", struct.pack("<i", 1))[0], 6)
    assert received_by_gcs() == 0
    world.autopilot.reboot()
    world.on(2.0)
    assert received_by_gcs() == 2


def test_px4_repeats_named_values_as_its_own_with_a_shorter_name() -> None:
    ours, echo = (191, "ABCDEFGHIJ"), (1, "ABCDEFGHI")
    for kind, expected in (("px4", {ours, echo}), ("ardupilot", {ours})):
        world = meeting(FakeAutopilot(kind))  # type: ignore[arg-type]
        world.companion.say(mavlink.MAVLink_named_value_float_message(1, b"ABCDEFGHIJ", 4.5))
        world.on(3.0)
        values = world.gcs.of("NAMED_VALUE_FLOAT")
        assert {(m.get_srcComponent(), m.name) for m in values} == expected
        assert len(values) == len(expected)


# Signing


def sign(peer: Any, link_id: int) -> None:
    peer._mav.signing.secret_key = KEY
    peer._mav.signing.sign_outgoing = True
    peer._mav.signing.link_id = link_id
    # The autopilot's clock: hundredths of milliseconds since 2015.
    peer._mav.signing.timestamp = int((1_795_211_406.0 - 1_420_070_400) * 1e5)


def test_with_a_key_unsigned_messages_are_ignored_except_on_usb() -> None:
    world = World(FakeAutopilot("ardupilot", signing_key=KEY))
    world.gcs.command(512, 148)
    world.on(0.1)
    assert world.gcs.of("COMMAND_ACK") == []
    sign(world.gcs, 5)
    world.gcs.command(512, 148)
    world.on(0.1)
    assert len(world.gcs.of("COMMAND_ACK")) == 1
    assert all(frame[2] & 1 for frame in world.gcs.frames), "a frame is not signed"
    receiver = mavlink.MAVLink(None)
    receiver.signing.secret_key = KEY
    received = [receiver.parse_buffer(frame)[0].get_type() for frame in world.gcs.frames]
    assert received.count("HEARTBEAT") >= 1
    hello = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(mavlink.MAVLink(None, 255, 190))
    for link in ("other", "usb"):
        world.autopilot.receive(world.t, link, bytes(hello))
    ports = world.autopilot._links.ports
    assert (ports["other"].active, ports["usb"].active) == (False, True)


def test_a_signed_message_needs_the_right_key_and_counts_once() -> None:
    world = World(FakeAutopilot("ardupilot", signing_key=KEY))
    sign(world.gcs, 5)
    frame = bytes(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(world.gcs._mav))
    command = mavlink.MAVLink_command_long_message(1, 1, 512, 0, 148, 0, 0, 0, 0, 0, 0)
    ping = bytes(command.pack(world.gcs._mav))
    for data in (frame, ping, ping, frame):
        world.autopilot.receive(world.t, "gcs", data)
    world.gcs._mav.signing.secret_key = bytes(32)
    world.gcs.command(512, 148)
    world.on(0.1)
    assert len(world.gcs.of("COMMAND_ACK")) == 1


# Missions


def test_px4_stops_a_cancelled_upload() -> None:
    world = World(FakeAutopilot("px4"))
    world.gcs.say(mavlink.MAVLink_mission_count_message(1, 1, 3))
    world.on(1.5)
    world.gcs.say(mavlink.MAVLink_mission_ack_message(1, 1, 15))
    world.gcs.forget()
    world.on(20.0)
    assert world.gcs.of("MISSION_REQUEST_INT", "MISSION_ACK") == []


@pytest.mark.parametrize("mission_type", [1, 2])
def test_there_are_no_fences_and_rally_points(mission_type: int) -> None:
    world = World(FakeAutopilot("ardupilot", mission=plan(TAKEOFF, LAND)))
    world.gcs.say(mavlink.MAVLink_mission_request_list_message(1, 1, mission_type))
    world.gcs.say(mavlink.MAVLink_mission_clear_all_message(1, 1, mission_type))
    world.on(0.1)
    assert [(m.count, m.mission_type) for m in world.gcs.of("MISSION_COUNT")] == [(0, mission_type)]
    assert [(m.type, m.mission_type) for m in world.gcs.of("MISSION_ACK")] == [(0, mission_type)]
    assert len(world.autopilot.items) == 3


# First requests


@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
def test_the_first_requests_of_clients_are_answered(kind: AutopilotKind) -> None:
    world = World(FakeAutopilot(kind))
    for command, param1 in ((512, 148), (520, 1), (410, 0), (511, 33), (510, 33)):
        world.gcs.command(command, param1, 200_000.0)
    world.on(0.1)
    assert [m.result for m in world.gcs.of("COMMAND_ACK")] == [0] * 5
    encoding = 16 if kind == "px4" else 131072
    for version in world.gcs.of("AUTOPILOT_VERSION"):
        assert version.capabilities & (encoding | 8192 | 4 | 32) == encoding | 8192 | 4
        assert version.uid
    assert len(world.gcs.of("AUTOPILOT_VERSION")) == 2
    assert world.gcs.of("MESSAGE_INTERVAL")[0].interval_us == 200_000
    if kind == "px4":
        assert world.gcs.of("HOME_POSITION")[0].latitude == round(SIMULATOR_HOME["px4"].latitude_deg * 1e7)


def test_px4_streams_to_a_ground_station_without_a_request() -> None:
    world = World(FakeAutopilot("px4"))
    world.gcs.hello()
    world.on(10.0)
    counts = {name: len(world.gcs.of(name)) for name in ("GLOBAL_POSITION_INT", "RC_CHANNELS", "GPS_RAW_INT")}
    assert counts == {"GLOBAL_POSITION_INT": 50, "RC_CHANNELS": 50, "GPS_RAW_INT": 10}
    world.gcs.say(mavlink.MAVLink_ping_message(7, 3, 0, 0))
    world.on(0.1)
    assert [(m.time_usec, m.seq, m.target_system) for m in world.gcs.of("PING")] == [(7, 3, 255)]
