"""The fake does what real autopilots were recorded to do: the same kinds of messages, in the same order."""

from __future__ import annotations

import struct
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import pytest
from autopilot_world import (
    RECORDINGS,
    STREAMS_HZ,
    Heard,
    Peer,
    World,
    changes,
    heartbeat,
    item,
    mission_events,
    parameter_bytes,
    plan,
    rc_health,
    rc_values,
    recording,
    timed_changes,
    upload,
)
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.fakes.autopilot import PX4_HOME, Autopilot, Kind
from flying_vines.vehicle.mission.item import MissionItem
from missions.waypoints import read_waypoints

GPS_HZ = {24: 1}
VINE_MISSION_HZ = {0: 1, 65: 10, 1: 2, 33: 5, 30: 5, 74: 2, 42: 2}
PX4_HZ = {1: 2, 30: 5, 33: 5, 42: 1, 74: 5, 4: 1, 29: 1, 87: 10, 242: 0.5, 245: 5}
ONLY_SIMULATED = {"RELAY_STATUS", "CAMERA_FEEDBACK"}


def kinds(heard: list[Heard], since_s: float = 0.0, until_s: float = 1e9) -> set[str]:
    return {message.get_type() for t, message in heard if since_s <= t < until_s} - ONLY_SIMULATED


def commands(heard: list[Heard]) -> list[str]:
    return [str(message) for _, message in heard if message.get_type() == "COMMAND_LONG"]


def test_rc_switch_as_recorded() -> None:
    real = recording("rc_switch")
    world = World(Autopilot("ardupilot"))
    autopilot = world.autopilot
    autopilot.set_mode("GUIDED")
    autopilot.set_rc(8, 1800)
    world.to(1.0)
    offset_s, start_s = 1.0, 0.05
    world.request_streams(STREAMS_HZ | GPS_HZ)
    script: list[tuple[float, Callable[[], None]]] = [(0.01, lambda: autopilot.takeoff(10.0))]
    moves = [(10.016, 1500), (14.016, 2000), (18.017, 1500), (21.017, 1000), (24.017, 2000), (28.017, 1000)]
    moves += [(31.018, 2000), (34.018, 1000), (34.518, 2000), (35.018, 1000), (35.518, 1500), (36.019, 2000)]
    moves += [(47.025, 1000), (55.036, 1500), (58.036, 2000), (70.048, 1000)]
    script += [(at_s, lambda us=us: autopilot.set_rc(9, us)) for at_s, us in moves]  # type: ignore[misc]
    script += [
        (39.024, lambda: autopilot.lose_rc("frozen")),
        (49.030, autopilot.return_rc),
        (53.036, lambda: autopilot.set_mode("GUIDED")),
        (62.042, lambda: autopilot.lose_rc("jump")),
        (67.048, autopilot.return_rc),
        (72.054, autopilot.land),
    ]
    for at_s, stimulus in sorted(script, key=lambda entry: entry[0]):
        world.to(offset_s + start_s + at_s)
        stimulus()
    world.to(offset_s + 88.0)
    fake = [(t - offset_s, message) for t, message in world.companion.heard if t >= offset_s]

    for name, view, tolerance_s in (("RC_CHANNELS", rc_values, 0.16), ("SYS_STATUS", rc_health, 0.55)):
        seen, expected = timed_changes(fake, name, view), timed_changes(real, name, view)
        assert [value for _, value in seen] == [value for _, value in expected]
        for (fake_s, _), (real_s, _) in zip(seen[1:], expected[1:], strict=True):
            assert fake_s == pytest.approx(real_s, abs=tolerance_s)
    modes = [changes(heartbeat(m) for _, m in heard if m.get_type() == "HEARTBEAT") for heard in (fake, real)]
    assert modes[0] == modes[1]
    assert mission_events(fake) == mission_events(real)
    assert kinds(fake) == kinds(real)


def test_ardupilot_mission_as_recorded() -> None:
    real = recording("ardupilot_vine_mission")
    items = read_waypoints(RECORDINGS / "ardupilot_vine_mission.waypoints")
    world = World(Autopilot("ardupilot"), upload(items))
    world.gcs.hello()
    world.request_streams(VINE_MISSION_HZ)
    world.companion.command(410)
    world.to(3.0)
    world.gcs.say(mavlink.MAVLink_mission_count_message(1, 1, len(items)))
    world.to(3.4)
    world.companion.download(len(items))
    world.to(6.08)
    world.autopilot.start_mission()
    world.to(100.0)
    fake = world.companion.heard

    assert mission_events(fake) == mission_events(real)
    assert kinds(fake) == kinds(real)
    for name, view in (
        ("MISSION_CURRENT", lambda m: (m.seq, m.mission_state, m.mission_mode)),
        ("HEARTBEAT", heartbeat),
    ):
        seen = [changes(view(m) for _, m in heard if m.get_type() == name) for heard in (fake, real)]
        assert seen[0] == seen[1]
    totals = [
        [m.param_value for _, m in heard if getattr(m, "param_id", "") == "MIS_TOTAL"]
        for heard in (fake, real)
    ]
    assert totals[0] == totals[1]
    # As in the autopilot's own log: items 3, 5, 7 and 9.
    assert [item.seq for _, item in world.autopilot.payload_log] == [3, 5, 7, 9]
    assert "Flight plan received" in world.gcs.texts()


def test_px4_mission_as_recorded() -> None:
    real = recording("px4_vine_mission")
    items = read_waypoints(RECORDINGS / "px4_vine_mission.waypoints")
    uploading = upload(items)

    def answer(peer: Peer, message: Any) -> None:
        uploading(peer, message)
        of_mission = {item.command for item in items}
        if (
            peer.link == "companion"
            and message.get_type() == "COMMAND_LONG"
            and message.command in of_mission
        ):
            peer.say(mavlink.MAVLink_command_ack_message(message.command, 0, 0, 0, 1, 1))

    world = World(Autopilot("px4"), answer)
    world.gcs.hello()
    world.request_streams(PX4_HZ)
    world.to(3.0)
    world.gcs.say(mavlink.MAVLink_mission_count_message(1, 1, len(items)))
    world.to(3.4)
    world.companion.download(len(items))
    world.to(6.02)
    world.autopilot.start_mission()
    world.to(90.0)
    fake = world.companion.heard

    assert commands(fake) == commands(real)
    assert kinds(fake) - {"COMMAND_ACK"} == kinds(real)
    beats = [changes(heartbeat(m) for _, m in heard if m.get_type() == "HEARTBEAT") for heard in (fake, real)]
    assert beats[0] == beats[1]
    reached = [
        changes(m.seq for _, m in heard if m.get_type() == "MISSION_ITEM_REACHED") for heard in (fake, real)
    ]
    # The real one polls: which of two items reached at once is hidden is chance.
    assert set(reached[1]) <= set(reached[0])
    assert set(reached[0]) - set(reached[1]) <= {item.seq - 1 for item in items if item.frame == 2}
    totals = [
        changes(m.total for _, m in heard if m.get_type() == "MISSION_CURRENT") for heard in (fake, real)
    ]
    assert totals[0] == totals[1] == [65535, 11]


def north(metres: float) -> tuple[float, ...]:
    return 0.0, 0.0, 0.0, 0.0, PX4_HOME.latitude_deg + metres * 9e-6, PX4_HOME.longitude_deg, 15.0


def px4_mission() -> list[MissionItem]:
    """The items that the recording's notes name, at places of our own: each leg takes seconds, as there."""
    places = {0: (22, north(0)), 12: (21, north(300))}
    places |= {seq: (16, north(25 * (seq + 1))) for seq in range(1, 13, 2)}
    dos = {
        2: (187, 0.5, -0.5, 0.25),
        4: (42600, 1.0, 1.0, 2.0, 0.5),
        6: (2000, 191.0, 0.5, 2.0),
        8: (203, 1.0, 2.0, 3.0, 4.0, 0.0, 77.0),
        10: (211, 1.0, 0.0),
    }
    items = [item(seq, command, *params) for seq, (command, params) in places.items()]
    items += [item(seq, int(command), *params, frame=2) for seq, (command, *params) in dos.items()]
    return sorted(items, key=lambda each: each.seq)


def test_px4_mission_with_overrides_and_a_pause_as_recorded() -> None:
    real = recording("px4_mission")
    items = px4_mission()
    uploading = upload(items)

    def answer(peer: Peer, message: Any) -> None:
        uploading(peer, message)
        is_command = peer.link == "companion" and message.get_type() == "COMMAND_LONG"
        if is_command and message.command in (187, 42600, 2000):
            peer.say(mavlink.MAVLink_command_ack_message(message.command, 0, 0, 0, 1, 1))

    def override(until_s: float, ch9_us: int) -> None:
        while world.t < until_s - 0.025:
            channels_us = (*(1500,) * 4, *(1000,) * 4, ch9_us, *(1500,) * 9)
            world.gcs.say(mavlink.MAVLink_rc_channels_override_message(1, 1, *channels_us))
            world.on(0.05)

    world = World(Autopilot("px4", rc_present=False, parameters={"MIS_COMMAND_TOUT": 5.0}), answer)
    world.gcs.hello()
    world.request_streams(PX4_HZ | {65: 10, 2: 1, 24: 1, 32: 1, 36: 1, 147: 0.5})
    for until_s, ch9_us in ((3.0, 1000), (6.0, 1500), (9.0, 2000)):
        override(until_s, ch9_us)
    world.to(13.0)
    override(16.04, 1000)
    for parameter, value in ((b"COM_RC_IN_MODE", 1), (b"NAV_RCL_ACT", 0)):
        as_bytes = struct.unpack("<f", struct.pack("<i", value))[0]
        world.gcs.say(mavlink.MAVLink_param_set_message(1, 1, parameter, as_bytes, 6))
    world.gcs.say(mavlink.MAVLink_mission_count_message(1, 1, len(items)))
    override(17.1, 1000)
    world.autopilot.start_mission()
    fake = world.companion.heard
    while not any(m.seq == 5 for m in world.companion.of("MISSION_CURRENT")):
        world.on(0.1)
    world.on(2.0)
    world.autopilot.set_mode("HOLD")
    world.on(4.0)
    world.autopilot.set_mode("MISSION")
    world.on(80.0)
    assert not world.autopilot.armed

    assert kinds(fake) - {"COMMAND_ACK"} == kinds(real)
    assert commands(fake) == commands(real)
    for name, view in (
        ("HEARTBEAT", heartbeat),
        ("RC_CHANNELS", rc_values),
        ("MISSION_CURRENT", lambda m: (m.seq, m.total, m.mission_state, m.mission_mode)),
        ("EXTENDED_SYS_STATE", lambda m: m.landed_state),
        ("SYS_STATUS", rc_health),
    ):
        seen = [changes(view(m) for _, m in heard if m.get_type() == name) for heard in (fake, real)]
        assert seen[0] == seen[1], name
    gaps_s = [
        max(b - a for a, b in pairwise(t for t, m in heard if m.get_type() == "RC_CHANNELS"))
        for heard in (fake, real)
    ]
    assert gaps_s[0] == pytest.approx(gaps_s[1], abs=0.15)
    assert max(t for t, m in fake if m.get_type() == "RC_CHANNELS") == pytest.approx(17.1, abs=0.15)
    reached = [
        changes(m.seq for _, m in heard if m.get_type() == "MISSION_ITEM_REACHED") for heard in (fake, real)
    ]
    assert set(reached[1]) <= set(reached[0])
    assert set(reached[0]) - set(reached[1]) <= {1, 5, 7}, "hidden by the DO item right behind"
    parameters = [
        [(m.param_id, parameter_bytes(m)) for _, m in heard if m.get_type() == "PARAM_VALUE"]
        for heard in (fake, real)
    ]
    assert parameters[0] == parameters[1][:2]
    assert [done.seq for _, done in world.autopilot.payload_log] == [2, 4, 6, 8, 10]


def test_two_reboots_as_recorded() -> None:
    real = recording("reboot")
    streams_hz = STREAMS_HZ | GPS_HZ
    world = World(Autopilot("ardupilot"))
    world.autopilot.set_rc(8, 1800)
    world.autopilot.set_rc(9, 1500)
    fake = world.companion.heard
    script: list[tuple[float, Callable[[], None]]] = [
        (0.05, lambda: world.request_streams(streams_hz)),
        (12.05, lambda: world.autopilot.set_rc(9, 2000)),
        (20.05, lambda: world.gcs.command(246, 1)),
        (20.5, world.companion.hello),
        (22.0, world.companion.hello),
        (30.1, lambda: world.request_streams(streams_hz)),
        (45.1, lambda: world.autopilot.set_rc(9, 1000)),
        (50.1, lambda: world.gcs.command(246, 1)),
        (52.0, world.companion.hello),
        (54.14, lambda: world.request_streams(streams_hz)),
    ]
    for at_s, stimulus in script:
        world.to(at_s)
        stimulus()
    world.to(64.5)

    assert kinds(fake) == kinds(real)
    # What has no stream asked for it: nobody is known any more, until the companion speaks and asks again.
    for since_s, until_s in ((21.0, 30.0), (51.0, 54.0)):
        spontaneous = kinds(fake, since_s, until_s), kinds(real, since_s, until_s)
        assert spontaneous[0] == spontaneous[1] - {"PARAM_VALUE"}
    for name, view, tolerance_s in (
        ("HEARTBEAT", heartbeat, 1.1),
        ("RC_CHANNELS", rc_values, 0.16),
        ("MISSION_CURRENT", lambda m: (m.seq, m.total, m.mission_state, m.mission_mode), 1.1),
    ):
        seen, expected = timed_changes(fake, name, view), timed_changes(real, name, view)
        assert [value for _, value in seen] == [value for _, value in expected]
        for (fake_s, _), (real_s, _) in zip(seen[1:], expected[1:], strict=True):
            assert fake_s == pytest.approx(real_s, abs=tolerance_s)
    for heard in (fake, real):
        falls = [
            (before.time_boot_ms, after.time_boot_ms)
            for before, after in pairwise(m for _, m in heard if m.get_type() == "RC_CHANNELS")
            if after.time_boot_ms < before.time_boot_ms
        ]
        assert len(falls) == 2
        assert [after for _, after in falls] == pytest.approx([8850, 2800], abs=1200)
        assert [t for t, _ in gaps(heard, 1.2)] == pytest.approx([20.05, 50.1], abs=0.1)
        assert [seconds for _, seconds in gaps(heard, 1.2)] == pytest.approx([1.26, 1.26], abs=0.1)
        assert [m.get_seq() for m in after_gaps(heard, 1.2)] == [0, 0]
        ready = [t for t, m in heard if m.get_type() == "STATUSTEXT" and m.text == "ArduPilot Ready"]
        assert ready == pytest.approx([22.71, 52.76], abs=0.1)
        assert len([m for _, m in heard if m.get_type() == "COMMAND_ACK" and m.result == 0]) == 24


def gaps(heard: list[Heard], longer_than_s: float) -> list[tuple[float, float]]:
    """When nothing was heard for so long, and how long."""
    return [(a, b - a) for (a, _), (b, _) in pairwise(heard) if b - a > longer_than_s]


def after_gaps(heard: list[Heard], longer_than_s: float) -> list[Any]:
    return [message for (a, _), (b, message) in pairwise(heard) if b - a > longer_than_s]


@pytest.mark.parametrize(
    ("kind", "name"), [("ardupilot", "ardupilot_vine_mission"), ("px4", "px4_vine_mission")]
)
def test_a_mission_downloads_as_recorded(kind: Kind, name: str) -> None:
    real = [str(m) for _, m in recording(name) if m.get_type() == "MISSION_ITEM_INT"]
    items = read_waypoints(RECORDINGS / f"{name}.waypoints")
    world = World(Autopilot(kind, mission=items))
    world.companion.download(len(items))
    world.on(0.1)
    assert world.companion.of("MISSION_COUNT")[0].count == len(items)
    fake = [str(message) for message in world.companion.of("MISSION_ITEM_INT")]
    # Only PX4 marks the current item.
    assert [text.replace("current : 1", "current : 0") for text in fake] == [
        text.replace("current : 1", "current : 0") for text in real[: len(items)]
    ]


def recorded_events(name: str) -> list[object]:
    """The mission's texts and reached items of an .events.txt, in order."""
    events: list[object] = []
    for line in (RECORDINGS / f"{name}.events.txt").read_text().splitlines():
        _, kind, rest = line.split(maxsplit=2)
        if kind == "MISSION_ITEM_REACHED":
            events.append(int(rest.strip("()").split(",")[0]))
        elif kind == "STATUSTEXT" and rest.startswith(("Mission: ", "Reached ")):
            events.append(rest)
    return events


def test_forty_six_kinds_of_items_as_recorded() -> None:
    real = recording("mission_do_items")

    def waypoint(metres: float, hold_s: float = 0.0) -> tuple[float, ...]:
        return (16, hold_s, 0, 0, 0, -35.363262 + metres * 9e-6, 149.165237, 15)

    bare = [(seq,) for seq in (600, 206, 182, 184, 216, 208, 215, 207, 222, 1000, 193, 189)]
    camera = ((202, 3, 60, 4, 100, 5, 6, 7), (203, 1, 2, 3, 4, 0, 77), (203, 0, 0, 0, 0, 1))
    mission = plan(
        *((22, 0, 0, 0, 0, 0, 0, 15), (217, 7, 1.5, -2.25, 300), waypoint(20)),
        *((181, 0, 1), (183, 9, 1900), (211, 1, 0), (42600, 1, 1, 2, 0.5), (218, 300, 2), waypoint(40)),
        *((42702, 5, 4), (201,), (178, 0, 5), *camera),
        *((2000,), (2001,), (206, 20), (531, 1, 2), (2500,), (2501,), waypoint(60, 3)),
        *bare,
        *((93, 4), (112, 1.5), (217, 8), (115,), (114, 1), (217, 9), waypoint(90)),
        *((217, 10), (218,), (211, 1, 1), (21,), (217, 11)),
    )
    world = World(Autopilot("ardupilot", mission=mission, parameters={"CAM1_TYPE": 5}))
    world.request_streams(STREAMS_HZ | GPS_HZ | {36: 5})
    world.autopilot.start_mission()
    world.on(100.0)
    fake = world.companion.heard

    events = mission_events(fake)
    # The recording begins after the take-off's own text.
    assert [e for e in events if isinstance(e, int) or e.startswith(("Mission: ", "Reached "))] == [
        "Mission: 1 Takeoff",
        *recorded_events("mission_do_items"),
    ]
    assert kinds(fake) == kinds(real)
    # The recorded ones after these are pictures taken by distance.
    assert commands(fake) == commands(real)[:3]
