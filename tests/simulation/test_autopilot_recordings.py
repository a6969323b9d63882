"""The simulated autopilot sends the kinds of messages of real recordings, in the same order."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from functools import partial
from itertools import pairwise
from typing import Any

import pytest
from autopilot_world import (
    RC_RECEIVER,
    RECORDINGS,
    STREAMS_HZ,
    Peer,
    Received,
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

from flying_vines.simulation.autopilot import AutopilotKind, FakeAutopilot
from flying_vines.vehicle.mission.item import MissionItem
from missions.home import SIMULATOR_HOME
from missions.waypoints import read_waypoints

GPS_HZ = {24: 1}
VINE_MISSION_HZ = {0: 1, 65: 10, 1: 2, 33: 5, 30: 5, 74: 2, 42: 2}
PX4_HZ = {1: 2, 30: 5, 33: 5, 42: 1, 74: 5, 4: 1, 29: 1, 87: 10, 242: 0.5, 245: 5}
SBUS_SEED, CRSF_SEED = 11, 1
"""With these seeds PX4 reports each loss with the same delay as in the recording."""
ONLY_SIMULATED = {"RELAY_STATUS", "CAMERA_FEEDBACK"}


def kinds(log: list[Received], since_s: float = 0.0, until_s: float = 1e9) -> set[str]:
    return {message.get_type() for t, message in log if since_s <= t < until_s} - ONLY_SIMULATED


def commands(log: list[Received]) -> list[str]:
    return [str(message) for _, message in log if message.get_type() == "COMMAND_LONG"]


View = Callable[[Any], object]
Script = list[tuple[float, Callable[[], None]]]
"""Times (s) and stimuli."""


def assert_same_changes(fake: list[Received], real: list[Received], views: Mapping[str, View]) -> None:
    """The same values of these messages in the same order."""
    for name, view in views.items():
        seen = [changes(view(m) for _, m in log if m.get_type() == name) for log in (fake, real)]
        assert seen[0] == seen[1], name


def assert_same_times(
    fake: list[Received], real: list[Received], views: Mapping[str, tuple[View, float]]
) -> None:
    """The same values of these messages in the same order, at about the same times: tolerance in s."""
    for name, (view, tolerance_s) in views.items():
        seen, expected = timed_changes(fake, name, view), timed_changes(real, name, view)
        assert expected and [value for _, value in seen] == [value for _, value in expected], name
        for (fake_s, _), (real_s, _) in zip(seen[1:], expected[1:], strict=True):
            assert fake_s == pytest.approx(real_s, abs=tolerance_s), name


def rc_bits(message: Any) -> tuple[bool, ...]:
    """Present, enabled, health."""
    sensors = "present", "enabled", "health"
    return tuple(bool(getattr(message, f"onboard_control_sensors_{name}") & RC_RECEIVER) for name in sensors)


def mission_current(message: Any) -> tuple[int, ...]:
    return message.seq, message.total, message.mission_state, message.mission_mode


def play(world: World, script: Script, until_s: float) -> None:
    for at_s, stimulus in sorted(script, key=lambda entry: entry[0]):
        world.to(at_s)
        stimulus()
    world.to(until_s)


def switch_moves(autopilot: FakeAutopilot, moves: str) -> Script:
    """Moves as "27.2 1500, 29.3 2000": s and µs."""
    pairs = (move.split() for move in moves.split(","))
    return [(float(at_s), partial(autopilot.set_rc, 9, int(us))) for at_s, us in pairs]


def outages(autopilot: FakeAutopilot, spans_s: str, *lost: Any) -> Script:
    """RC losses as "32.3-42.3 50.4-56.4", and the arguments of `lose_rc`."""
    ends = (span.split("-") for span in spans_s.split())
    losses = [(float(a), float(b)) for a, b in ends]
    return [(a, partial(autopilot.lose_rc, *lost)) for a, _ in losses] + [
        (b, autopilot.return_rc) for _, b in losses
    ]


def test_rc_switch_as_recorded() -> None:
    real = recording("rc_switch")
    world = World(FakeAutopilot("ardupilot"))
    autopilot = world.autopilot
    autopilot.set_mode("GUIDED")
    autopilot.set_rc(8, 1800)
    world.to(1.0)
    world.request_streams(STREAMS_HZ | GPS_HZ)
    script = switch_moves(
        autopilot,
        "10.016 1500, 14.016 2000, 18.017 1500, 21.017 1000, 24.017 2000, 28.017 1000, 31.018 2000,"
        "34.018 1000, 34.518 2000, 35.018 1000, 35.518 1500, 36.019 2000, 47.025 1000, 55.036 1500,"
        "58.036 2000, 70.048 1000",
    )
    script += outages(autopilot, "39.024-49.030", "frozen") + outages(autopilot, "62.042-67.048", "jump")
    script += [
        (0.01, partial(autopilot.takeoff, 10.0)),
        (53.036, partial(autopilot.set_mode, "GUIDED")),
        (72.054, autopilot.land),
    ]
    play(world, [(1.05 + at_s, stimulus) for at_s, stimulus in script], 89.0)
    fake = [(t - 1.0, message) for t, message in world.companion.received if t >= 1.0]

    assert_same_times(fake, real, {"RC_CHANNELS": (rc_values, 0.16), "SYS_STATUS": (rc_health, 0.55)})
    assert_same_changes(fake, real, {"HEARTBEAT": heartbeat})
    assert mission_events(fake) == mission_events(real)
    assert kinds(fake) == kinds(real)


def test_ardupilot_mission_as_recorded() -> None:
    real = recording("ardupilot_vine_mission")
    items = read_waypoints(RECORDINGS / "ardupilot_vine_mission.waypoints")
    world = World(FakeAutopilot("ardupilot"), upload(items))
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
    fake = world.companion.received

    assert mission_events(fake) == mission_events(real)
    assert kinds(fake) == kinds(real)
    views: dict[str, View] = {
        "MISSION_CURRENT": lambda m: (m.seq, m.mission_state, m.mission_mode),
        "HEARTBEAT": heartbeat,
    }
    assert_same_changes(fake, real, views)
    totals = [
        [m.param_value for _, m in log if getattr(m, "param_id", "") == "MIS_TOTAL"] for log in (fake, real)
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

    world = World(FakeAutopilot("px4"), answer)
    world.gcs.hello()
    world.request_streams(PX4_HZ)
    world.to(3.0)
    world.gcs.say(mavlink.MAVLink_mission_count_message(1, 1, len(items)))
    world.to(3.4)
    world.companion.download(len(items))
    world.to(6.02)
    world.autopilot.start_mission()
    world.to(90.0)
    fake = world.companion.received

    assert commands(fake) == commands(real)
    assert kinds(fake) - {"COMMAND_ACK"} == kinds(real)
    assert_same_changes(fake, real, {"HEARTBEAT": heartbeat})
    reached = [
        changes(m.seq for _, m in log if m.get_type() == "MISSION_ITEM_REACHED") for log in (fake, real)
    ]
    # The real one polls, so chance decides which of two items reached at once is hidden.
    assert set(reached[1]) <= set(reached[0])
    assert set(reached[0]) - set(reached[1]) <= {item.seq - 1 for item in items if item.frame == 2}
    totals = [changes(m.total for _, m in log if m.get_type() == "MISSION_CURRENT") for log in (fake, real)]
    assert totals[0] == totals[1] == [65535, 11]


def north(metres: float) -> tuple[float, ...]:
    return (
        0.0,
        0.0,
        0.0,
        0.0,
        SIMULATOR_HOME["px4"].latitude_deg + metres * 9e-6,
        SIMULATOR_HOME["px4"].longitude_deg,
        15.0,
    )


def px4_mission() -> list[MissionItem]:
    """The items of the recording's notes at other places; each leg takes seconds, as there."""
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


PX4_RC_HZ = {65: 20, 1: 10, 33: 5, 2: 1}


def test_px4_sbus_losses_as_recorded() -> None:
    real = recording("px4_sbus_failsafe")
    world = World(FakeAutopilot("px4", receiver="sbus", rc_failsafe_mode="HOLD", seed=SBUS_SEED))
    autopilot = world.autopilot
    for channel in range(1, 17):
        autopilot.set_rc(channel, 999 if channel == 9 else 1499)
    world.request_streams(PX4_RC_HZ)

    script = switch_moves(
        autopilot,
        "27.2 1499, 27.81 999, 29.32 1999, 37 999, 48.33 1499, 48.93 999, 61.43 1499, 62.04 999,"
        "74.73 1499, 75.33 999, 76.85 1999, 85 999, 95.87 1499, 96.48 999, 108.99 1499, 109.6 999",
    )
    script += outages(autopilot, "32.25-42.32 79.8-89.82", "frozen")
    presets_s = "50.44-56.43 63.55-63.76 66.24-66.64 69.17-70.18 97.94-103.95 111.06-111.26 113.78-114.19"
    script += outages(autopilot, f"{presets_s} 116.76-117.72", "jump", {9: 1999})
    script += [(4.9, partial(autopilot.takeoff, 25.0)), (25.5, partial(autopilot.set_mode, "HOLD"))]
    play(world, script, 120.3)
    fake, until_120 = world.companion.received, [h for h in real if h[0] < 120.3]
    assert_same_times(fake, until_120, {"RC_CHANNELS": (rc_values, 0.16), "SYS_STATUS": (rc_bits, 0.6)})
    fake, until_119 = ([entry for entry in log if entry[0] < 119.0] for log in (fake, real))
    assert_same_changes(fake, until_119, {"HEARTBEAT": lambda m: m.system_status})


def test_px4_crsf_losses_as_recorded() -> None:
    # The companion's process paused at 4.4 s.
    real = [entry for entry in recording("px4_crsf_loss") if entry[0] >= 6.0]
    world = World(FakeAutopilot("px4", receiver="crsf", rc_failsafe_mode="HOLD", seed=CRSF_SEED))
    autopilot = world.autopilot
    for channel in range(1, 17):
        autopilot.set_rc(channel, 1012 if channel == 9 else 1500)
    world.request_streams(PX4_RC_HZ)
    script = switch_moves(
        autopilot,
        "26.41 1500, 26.98 1012, 28.54 1988, 36 1012, 47.5 1500, 48.16 1012, 52 1988, 56.83 1500,"
        "57.44 1012, 60.97 1500, 61.54 1012, 63.04 1988, 70 1012, 82.08 1500, 82.68 1012, 86 1988",
    )
    script += outages(autopilot, "31.52-41.51 49.65-53.85 66.05-76.08 84.18-88.4")
    script += [(6.1, partial(autopilot.takeoff, 25.0)), (24.6, partial(autopilot.set_mode, "HOLD"))]
    play(world, script, 90.0)
    until_90 = [h for h in real if h[0] < 90.0]
    fake = [h for h in world.companion.received if h[0] >= 6.0]

    # Chance decides if the first frame after a loss lacks its rssi, so it is tested separately.
    views: dict[str, tuple[View, float]] = {
        "RC_CHANNELS": (lambda m: rc_values(m)[:-1], 0.2),
        "SYS_STATUS": (rc_bits, 0.6),
    }
    assert_same_times(fake, until_90, views)
    rssi = [timed_changes(log, "RC_CHANNELS", lambda m: m.rssi) for log in (fake, until_90)]
    assert [value for _, value in rssi[0]] == [value for _, value in rssi[1]] == [61, 255] * 4 + [61]
    gone_s = [[t for t, value in log if value == 255] for log in rssi]
    assert gone_s[0] == pytest.approx(gone_s[1], abs=0.16)


def test_ardupilot_losses_reported_and_hidden_as_recorded() -> None:
    real = recording("ardupilot_hidden_rc_loss")
    world = World(FakeAutopilot("ardupilot", rc_failsafe_mode=None))
    autopilot = world.autopilot
    autopilot.set_mode("GUIDED")
    autopilot.takeoff(10.0)
    for channel in range(1, 17):
        autopilot.set_rc(channel, {3: 1000, 5: 1800, 8: 1800}.get(channel, 1500 if channel < 5 else 1000))
    world.to(20.0)
    autopilot.set_rc(9, 2000)
    autopilot.lose_rc("jump")
    world.to(21.0)
    offset_s = world.t
    world.request_streams({65: 20, 1: 10, 33: 5, 2: 1, 42: 5})
    world.on(0.15)
    world.companion.forget()
    script = switch_moves(
        autopilot,
        "4.37 1000, 9 1500, 14.97 1000, 19 2000, 23.52 1000, 29.43 2000, 32.42 1000, 38.58 2000,"
        "41.63 1000, 46 2000, 52.17 1000",
    )
    script += outages(autopilot, "6.87-10.92", "jump")
    script += outages(autopilot, "17.44-20.5 26.02-29.07 34.91-37.95 44.13-48.17", "frozen")
    script += [(0.36, autopilot.return_rc)]
    script += [(41.59, partial(autopilot.parameters.change, "FS_THR_ENABLE", 0.0))]
    play(world, [(offset_s + at_s, stimulus) for at_s, stimulus in script], offset_s + 54.0)
    fake = [(t - offset_s, message) for t, message in world.companion.received]
    until_54 = [h for h in real if h[0] < 54.0]
    assert_same_times(fake, until_54, {"RC_CHANNELS": (rc_values, 0.16), "SYS_STATUS": (rc_bits, 0.3)})
    for log in (fake, until_54):
        told = [(m.param_id, m.param_value) for _, m in log if m.get_type() == "PARAM_VALUE"]
        told = [(name, value) for name, value in told if not name.startswith(("SIM_", "STAT_"))]
        assert told == [("FS_THR_ENABLE", 0.0)]
    texts = [[m.text for _, m in log if m.get_type() == "STATUSTEXT"] for log in (fake, until_54)]
    assert texts[0] == texts[1]


def test_an_override_that_expires_and_a_link_that_stalls_as_recorded() -> None:
    real = recording("ardupilot_override_and_late_texts")
    delay = (93, 4, 0, 0, 0, 0, 0, 0)
    items = plan(delay, (217, 1, 40), delay, (217, 0), delay, (20,))
    world = World(FakeAutopilot("ardupilot"))
    autopilot = world.autopilot
    for channel in range(1, 17):
        autopilot.set_rc(channel, {5: 1800, 8: 1800}.get(channel, 1500 if channel < 5 else 1000))
    autopilot.takeoff(10.0)
    world.to(40.0)
    world.request_streams({65: 20, 1: 10, 33: 5, 2: 1, 42: 5})
    world.gcs.hello()

    def override() -> None:
        world.gcs.say(mavlink.MAVLink_rc_channels_override_message(1, 1, *(65535,) * 8, 1000, *(0,) * 9))

    script = switch_moves(autopilot, "48.88 2000, 61.42 1000")
    script += [(52.37 + 0.2 * step, override) for step in range(21)]
    script += [
        (63.42, lambda: autopilot.replace_mission(items)),
        (66.0, lambda: autopilot.set_current(1)),
        (67.487, lambda: autopilot.set_mode("AUTO")),
        (70.0, lambda: autopilot.stall(9.02)),
    ]
    play(world, script, 79.2)
    fake = world.companion.received

    for log in (fake, real):
        switch = [
            (t, us) for t, us in timed_changes(log, "RC_CHANNELS", lambda m: m.chan9_raw) if 45.0 < t < 70.0
        ]
        assert [us for _, us in switch] == [2000, 1000, 2000, 1000]
        assert [t for t, _ in switch] == pytest.approx([48.9, 52.4, 59.36, 61.45], abs=0.1)
        totals = [m.param_value for _, m in log if getattr(m, "param_id", "") == "MIS_TOTAL"][:7]
        assert totals == [1, 2, 3, 4, 5, 6, 7]
        late = [
            (t, m.text if m.get_type() == "STATUSTEXT" else m.seq)
            for t, m in log
            if 67.4 < t < 79.2 and m.get_type() in ("STATUSTEXT", "MISSION_ITEM_REACHED")
        ]
        first = ["Mission: 1 Delay", "Delaying 4 sec"]
        held_back = [1, "Mission: 2 Scripting", "Mission: 3 Delay", "Delaying 4 sec", 3]
        assert [what for _, what in late][:10] == [*first, *first, *held_back, "Mission: 4 Scripting"]
        assert all(t == pytest.approx(67.5, abs=0.1) for t, _ in late[:4])
        assert all(t == pytest.approx(79.06, abs=0.1) for t, _ in late[4:])
        # The messages that arrived with it show its age.
        boots_ms = [m.time_boot_ms for t, m in log if m.get_type() == "RC_CHANNELS" and 79.0 < t < 79.12]
        assert boots_ms[-1] - boots_ms[0] > 8000
    assert "Flight plan received" in world.gcs.texts()
    assert not any("Flight plan" in text for text in world.companion.texts())
    assert [done.seq for _, done in autopilot.payload_log] == [2, 4]


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

    world = World(FakeAutopilot("px4", rc_present=False, parameters={"MIS_COMMAND_TOUT": 5.0}), answer)
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
    fake = world.companion.received
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
    views: dict[str, View] = {"HEARTBEAT": heartbeat, "RC_CHANNELS": rc_values, "SYS_STATUS": rc_health}
    views |= {"MISSION_CURRENT": mission_current, "EXTENDED_SYS_STATE": lambda m: m.landed_state}
    assert_same_changes(fake, real, views)
    gaps_s = [
        max(b - a for a, b in pairwise(t for t, m in log if m.get_type() == "RC_CHANNELS"))
        for log in (fake, real)
    ]
    assert gaps_s[0] == pytest.approx(gaps_s[1], abs=0.15)
    assert max(t for t, m in fake if m.get_type() == "RC_CHANNELS") == pytest.approx(17.1, abs=0.15)
    reached = [
        changes(m.seq for _, m in log if m.get_type() == "MISSION_ITEM_REACHED") for log in (fake, real)
    ]
    assert set(reached[1]) <= set(reached[0])
    assert set(reached[0]) - set(reached[1]) <= {1, 5, 7}, "hidden by the DO item right behind"
    parameters = [
        [(m.param_id, parameter_bytes(m)) for _, m in log if m.get_type() == "PARAM_VALUE"]
        for log in (fake, real)
    ]
    assert parameters[0] == parameters[1][:2]
    assert [done.seq for _, done in world.autopilot.payload_log] == [2, 4, 6, 8, 10]


def test_two_reboots_as_recorded() -> None:
    real = recording("reboot")
    streams_hz = STREAMS_HZ | GPS_HZ
    world = World(FakeAutopilot("ardupilot"))
    world.autopilot.set_rc(8, 1800)
    world.autopilot.set_rc(9, 1500)
    fake = world.companion.received
    script = switch_moves(world.autopilot, "12.05 2000, 45.1 1000")
    script += [(at_s, partial(world.gcs.command, 246, 1)) for at_s in (20.05, 50.1)]
    script += [(at_s, world.companion.hello) for at_s in (20.5, 22.0, 52.0)]
    script += [(at_s, partial(world.request_streams, streams_hz)) for at_s in (0.05, 30.1, 54.14)]
    play(world, script, 64.5)

    assert kinds(fake) == kinds(real)
    # Streams must be requested again: nobody is known until the companion sends and requests them.
    for since_s, until_s in ((21.0, 30.0), (51.0, 54.0)):
        spontaneous = kinds(fake, since_s, until_s), kinds(real, since_s, until_s)
        assert spontaneous[0] == spontaneous[1] - {"PARAM_VALUE"}
    views: dict[str, tuple[View, float]] = {"HEARTBEAT": (heartbeat, 1.1), "RC_CHANNELS": (rc_values, 0.16)}
    assert_same_times(fake, real, views | {"MISSION_CURRENT": (mission_current, 1.1)})
    for log in (fake, real):
        falls = [
            (before.time_boot_ms, after.time_boot_ms)
            for before, after in pairwise(m for _, m in log if m.get_type() == "RC_CHANNELS")
            if after.time_boot_ms < before.time_boot_ms
        ]
        assert len(falls) == 2
        assert [after for _, after in falls] == pytest.approx([8850, 2800], abs=1200)
        silences = [(a, b - a, m.get_seq()) for (a, _), (b, m) in pairwise(log) if b - a > 1.2]
        assert [t for t, _, _ in silences] == pytest.approx([20.05, 50.1], abs=0.1)
        assert [seconds for _, seconds, _ in silences] == pytest.approx([1.26, 1.26], abs=0.1)
        assert [seq for _, _, seq in silences] == [0, 0]
        ready = [t for t, m in log if m.get_type() == "STATUSTEXT" and m.text == "ArduPilot Ready"]
        assert ready == pytest.approx([22.71, 52.76], abs=0.1)
        assert len([m for _, m in log if m.get_type() == "COMMAND_ACK" and m.result == 0]) == 24


@pytest.mark.parametrize(
    ("kind", "name"), [("ardupilot", "ardupilot_vine_mission"), ("px4", "px4_vine_mission")]
)
def test_a_mission_downloads_as_recorded(kind: AutopilotKind, name: str) -> None:
    real = [str(m) for _, m in recording(name) if m.get_type() == "MISSION_ITEM_INT"]
    items = read_waypoints(RECORDINGS / f"{name}.waypoints")
    world = World(FakeAutopilot(kind, mission=items))
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
    world = World(FakeAutopilot("ardupilot", mission=mission, parameters={"CAM1_TYPE": 5}))
    world.request_streams(STREAMS_HZ | GPS_HZ | {36: 5})
    world.autopilot.start_mission()
    world.on(100.0)
    fake = world.companion.received

    events = mission_events(fake)
    # The recording begins after the take-off's own text.
    assert [e for e in events if isinstance(e, int) or e.startswith(("Mission: ", "Reached "))] == [
        "Mission: 1 Takeoff",
        *recorded_events("mission_do_items"),
    ]
    assert kinds(fake) == kinds(real)
    # The recorded ones after these are pictures taken by distance.
    assert commands(fake) == commands(real)[:3]
