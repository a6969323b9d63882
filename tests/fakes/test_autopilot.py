"""The fake autopilot against what real ones were recorded to do."""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Callable, Iterable, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.fakes.autopilot import Autopilot, Kind, MissionRefused
from flying_vines.vehicle.mission.item import MissionItem
from missions.waypoints import read_waypoints

RECORDINGS = Path(__file__).parents[1] / "data" / "recordings"

RC_RECEIVER = 0x10000
STREAMS_HZ = {65: 10, 1: 2, 33: 5, 30: 5, 74: 5, 42: 2, 2: 1}

Heard = tuple[float, Any]


class Peer:
    """Someone on a link: speaks, and keeps what the autopilot says to it."""

    def __init__(self, world: World, link: str, system: int, component: int, kind: int) -> None:
        self.world = world
        self.link = link
        self.kind = kind
        self.heard: list[Heard] = []
        self.frames: list[bytes] = []
        self._mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        self._ears = mavlink.MAVLink(None)

    def say(self, message: Any) -> None:
        frame = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        self.world.autopilot.receive(self.world.t, self.link, bytes(frame))

    def hello(self) -> None:
        self.say(mavlink.MAVLink_heartbeat_message(self.kind, 8, 0, 0, 4, 3))

    def command(self, command: int, *params: float, to: tuple[int, int] = (1, 1)) -> None:
        seven = (*params, *(0.0,) * (7 - len(params)))
        self.say(mavlink.MAVLink_command_long_message(*to, command, 0, *seven))

    def hear(self, frame: bytes) -> None:
        self.frames.append(frame)
        for message in self._ears.parse_buffer(frame) or []:
            self.heard.append((self.world.t, message))

    def of(self, *names: str) -> list[Any]:
        return [message for _, message in self.heard if message.get_type() in names]

    def texts(self) -> list[str]:
        return [message.text for message in self.of("STATUSTEXT")]

    def forget(self) -> None:
        self.heard.clear()
        self.frames.clear()


class World:
    """An autopilot, a companion and a ground station, and the time."""

    def __init__(self, autopilot: Autopilot, answer: Callable[[Peer, Any], None] | None = None) -> None:
        self.autopilot = autopilot
        autopilot.add_link("gcs")
        self.t = 0.0
        self.companion = Peer(self, "companion", 1, 191, 18)
        self.gcs = Peer(self, "gcs", 255, 190, 6)
        self._answer = answer
        self.to(0.0)

    def to(self, t: float) -> None:
        steps = max(1, round((t - self.t) / 0.01))
        start = self.t
        for step in range(1, steps + 1):
            self.t = start + (t - start) * step / steps
            for link, frame in self.autopilot.advance(self.t):
                peer = self.companion if link == "companion" else self.gcs
                before = len(peer.heard)
                peer.hear(frame)
                if self._answer is not None:
                    for _, message in peer.heard[before:]:
                        self._answer(peer, message)

    def on(self, seconds: float) -> None:
        self.to(self.t + seconds)

    def request_streams(self) -> None:
        self.companion.hello()
        for message_id, rate_hz in STREAMS_HZ.items():
            self.companion.command(511, message_id, 1e6 / rate_hz)


def upload(items: Sequence[MissionItem]) -> Callable[[Peer, Any], None]:
    """Answers requests for items as a ground station does during an upload."""

    def answer(peer: Peer, message: Any) -> None:
        if peer.link != "gcs" or message.get_type() not in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
            return
        item = items[message.seq]
        scale = 1.0 if item.frame == 2 else 1e7
        x, y = round(item.params[4] * scale), round(item.params[5] * scale)
        head = (1, 1, item.seq, item.frame, item.command, 0, 1)
        peer.say(mavlink.MAVLink_mission_item_int_message(*head, *item.params[:4], x, y, item.params[6]))

    return answer


def recording(name: str) -> list[Heard]:
    """The messages of a .tlog with the time since the first."""
    data = (RECORDINGS / f"{name}.tlog").read_bytes()
    ears = mavlink.MAVLink(None)
    ears.robust_parsing = True
    heard: list[Heard] = []
    first_us, at = -1, 0
    while at < len(data):
        (unix_us,) = struct.unpack_from(">Q", data, at)
        length = 12 + data[at + 9] + (13 if data[at + 10] & 1 else 0)
        first_us = unix_us if first_us < 0 else first_us
        for message in ears.parse_buffer(data[at + 8 : at + 8 + length]) or []:
            if message.get_srcSystem() == 1:
                heard.append(((unix_us - first_us) / 1e6, message))
        at += 8 + length
    return heard


def changes(values: Iterable[Any]) -> list[Any]:
    """The values without repeats in a row."""
    return [value for value, _ in groupby(values)]


def timed_changes(
    heard: Iterable[Heard], name: str, view: Callable[[Any], object]
) -> list[tuple[float, object]]:
    out: list[tuple[float, object]] = []
    for t, message in heard:
        if message.get_type() == name and (not out or out[-1][1] != view(message)):
            out.append((t, view(message)))
    return out


def rc_values(message: Any) -> tuple[int, ...]:
    channels = tuple(getattr(message, f"chan{channel}_raw") for channel in range(1, 19))
    return (*channels, message.chancount, message.rssi)


def rc_health(message: Any) -> bool:
    return bool(message.onboard_control_sensors_health & RC_RECEIVER)


def heartbeat(message: Any) -> tuple[int, int, int]:
    return message.base_mode, message.custom_mode, message.system_status


def mission_events(heard: Iterable[Heard]) -> list[str | int]:
    """Status texts and reached items in order, without what only the simulator or the EKF says."""
    events: list[str | int] = []
    for _, message in heard:
        if message.get_type() == "STATUSTEXT" and not message.text.startswith(("EKF3", "SIM ")):
            events.append(message.text)
        elif message.get_type() == "MISSION_ITEM_REACHED":
            events.append(message.seq)
    return events


# Replays of the recordings' stimuli


def test_rc_switch_as_recorded() -> None:
    real = recording("rc_switch")
    world = World(Autopilot("ardupilot"))
    autopilot = world.autopilot
    autopilot.set_mode("GUIDED")
    autopilot.set_rc(8, 1800)
    world.to(1.0)
    offset_s, start_s = 1.0, 0.05
    world.request_streams()
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


def test_ardupilot_mission_as_recorded() -> None:
    real = recording("ardupilot_vine_mission")
    items = read_waypoints(RECORDINGS / "ardupilot_vine_mission.waypoints")
    world = World(Autopilot("ardupilot"), upload(items))
    world.gcs.hello()
    world.request_streams()
    world.to(3.0)
    world.gcs.say(mavlink.MAVLink_mission_count_message(1, 1, len(items)))
    world.to(6.08)
    world.autopilot.start_mission()
    world.to(100.0)
    fake = world.companion.heard

    assert mission_events(fake) == mission_events(real)
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
    world.request_streams()
    world.to(3.0)
    world.gcs.say(mavlink.MAVLink_mission_count_message(1, 1, len(items)))
    world.to(6.02)
    world.autopilot.start_mission()
    world.to(90.0)
    fake = world.companion.heard

    def commands(heard: list[Heard]) -> list[str]:
        return [str(message) for _, message in heard if message.get_type() == "COMMAND_LONG"]

    assert commands(fake) == commands(real)
    assert [m for _, m in fake if m.get_type() == "STATUSTEXT"] == []
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


@pytest.mark.parametrize(
    ("kind", "name"), [("ardupilot", "ardupilot_vine_mission"), ("px4", "px4_vine_mission")]
)
def test_a_mission_downloads_as_recorded(kind: Kind, name: str) -> None:
    real = [str(m) for _, m in recording(name) if m.get_type() == "MISSION_ITEM_INT"]
    items = read_waypoints(RECORDINGS / f"{name}.waypoints")
    world = World(Autopilot(kind, mission=items))
    world.companion.say(mavlink.MAVLink_mission_request_list_message(1, 1))
    for seq in range(len(items)):
        world.companion.say(mavlink.MAVLink_mission_request_int_message(1, 1, seq))
    world.on(0.1)
    assert world.companion.of("MISSION_COUNT")[0].count == len(items)
    fake = [str(message) for message in world.companion.of("MISSION_ITEM_INT")]
    # Only PX4 marks the current item.
    assert [text.replace("current : 1", "current : 0") for text in fake] == [
        text.replace("current : 1", "current : 0") for text in real[: len(items)]
    ]


# ArduPilot's mission quirks


def home() -> MissionItem:
    return MissionItem(0, 16, (0.0,) * 7)


def item(seq: int, command: int, *params: float, frame: int = 3) -> MissionItem:
    p1, p2, p3, p4, x, y, z = (*params, *(0.0,) * (7 - len(params)))
    return MissionItem(seq, command, (p1, p2, p3, p4, x, y, z), frame)


def plan(*commands: tuple[float, ...]) -> list[MissionItem]:
    """Home, then the given (command, param1, …) one after the other."""
    return [home(), *(item(seq, int(c[0]), *c[1:]) for seq, c in enumerate(commands, start=1))]


TAKEOFF = (22, 0, 0, 0, 0, 0, 0, 5)
WAYPOINT = (16, 0, 0, 0, 0, -35.3631, 149.165237, 5)
LAND = (21,)


def flown(mission: list[MissionItem], seconds: float = 60.0) -> World:
    world = World(Autopilot("ardupilot", mission=mission))
    world.companion.hello()
    world.autopilot.start_mission()
    world.on(seconds)
    return world


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


def test_after_the_last_waypoint_only_the_first_do_item_runs_and_after_land_none() -> None:
    world = flown(plan(TAKEOFF, WAYPOINT, (217, 1), (217, 2)))
    assert [done.seq for _, done in world.autopilot.payload_log] == [3]
    world = flown(plan(TAKEOFF, LAND, (217, 1)))
    assert not world.autopilot.armed
    assert world.autopilot.payload_log == []


def test_a_payload_item_in_front_runs_on_the_ground_and_twice_more_after_landing() -> None:
    world = flown(plan((217, 1, 40), TAKEOFF, LAND))
    assert not world.autopilot.armed
    assert [done.seq for _, done in world.autopilot.payload_log] == [1, 1, 1]


def test_a_waypoint_followed_by_an_item_with_reached_loses_its_own() -> None:
    world = flown(plan(TAKEOFF, WAYPOINT, (178, 0, 5, -1), (93, 1), LAND))
    assert [message.seq for message in world.companion.of("MISSION_ITEM_REACHED")] == [1, 3, 4]


def test_do_jump_runs_an_item_again_under_the_same_seq() -> None:
    world = flown(plan(TAKEOFF, WAYPOINT, (217, 1, 40), (93, 1), (177, 2, 2), LAND), 90.0)
    assert [done.seq for _, done in world.autopilot.payload_log] == [3, 3, 3]
    assert not world.autopilot.armed


def test_a_do_item_behind_a_condition_is_dropped_if_the_waypoint_comes_first() -> None:
    world = flown(plan(TAKEOFF, WAYPOINT, (112, 60), (217, 1), (93, 1), LAND))
    assert world.autopilot.payload_log == []
    world = flown(plan(TAKEOFF, WAYPOINT, (112, 1.5), (217, 1), (93, 4), LAND))
    assert [done.seq for _, done in world.autopilot.payload_log] == [4]


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


def test_forty_six_kinds_of_items_run_in_the_recorded_order() -> None:
    def waypoint(metres: float, hold_s: float = 0.0) -> tuple[float, ...]:
        return (16, hold_s, 0, 0, 0, -35.363262 + metres * 9e-6, 149.165237, 15)

    world = flown(
        plan(
            *((22, 0, 0, 0, 0, 0, 0, 15), (217, 7, 1.5, -2.25, 300), waypoint(20)),
            *((181, 0, 1), (183, 9, 1900), (211, 1, 0), (42600, 1, 1, 2, 0.5), (218, 300, 2), waypoint(40)),
            *((42702, 5, 4), (201,), (178, 0, 5), (202, 3, 60, 4, 100, 5, 6, 7), (203, 1), (203,)),
            *((2000,), (2001,), (206, 20), (531, 1, 2), (2500,), (2501,), waypoint(60, 3)),
            *(
                (600,),
                (206,),
                (182,),
                (184,),
                (216,),
                (208,),
                (215,),
                (207,),
                (222,),
                (1000,),
                (193,),
                (189,),
            ),
            *((93, 4), (112, 1.5), (217, 8), (115,), (114, 1), (217, 9), waypoint(90)),
            *((217, 10), (218,), (211, 1, 1), (21,), (217, 11)),
        ),
        seconds=100.0,
    )
    fake = mission_events(world.companion.heard)
    # The recording begins after the take-off's own text.
    assert [e for e in fake if isinstance(e, int) or e.startswith(("Mission: ", "Reached "))] == [
        "Mission: 1 Takeoff",
        *recorded_events("mission_do_items"),
    ]


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
def test_what_survives_ardupilots_storage(sent: tuple[float, ...], kept: tuple[float, ...]) -> None:
    stored = Autopilot("ardupilot", mission=plan(sent)).items[1]
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
def test_a_refused_item_ends_the_upload(kind: Kind, refused: MissionItem, result: int) -> None:
    with pytest.raises(MissionRefused):
        Autopilot(kind, mission=[home(), refused])
    good = item(2, 16, 0.0, 0.0, 0.0, 0.0, 47.0, 8.0, 5.0)
    old = [home(), item(1, 22), item(2, 22)] if kind == "ardupilot" else [item(0, 22), item(1, 22)]
    first = home() if kind == "ardupilot" else item(0, 16, 0, 0, 0, 0, 47, 8, 5)
    world = World(Autopilot(kind, mission=old), upload([first, refused, good]))
    world.gcs.say(mavlink.MAVLink_mission_count_message(1, 1, 3))
    world.on(1.0)
    assert [message.type for message in world.gcs.of("MISSION_ACK")] == [result]
    assert [stored.command for stored in world.autopilot.items] == [stored.command for stored in old]


def test_a_refused_upload_to_ardupilot_leaves_a_mixed_mission() -> None:
    new = plan((217, 1), (31010,), LAND)
    world = World(Autopilot("ardupilot", mission=plan(TAKEOFF, WAYPOINT, LAND)), upload(new))
    world.gcs.say(mavlink.MAVLink_mission_count_message(1, 1, len(new)))
    world.on(1.0)
    assert [stored.command for stored in world.autopilot.items] == [16, 217, 16, 21]


def test_an_upload_is_asked_for_again_and_then_given_up() -> None:
    world = World(Autopilot("ardupilot"))
    world.gcs.say(mavlink.MAVLink_mission_count_message(1, 1, 3))
    world.on(20.0)
    assert len(world.gcs.of("MISSION_REQUEST")) == 8
    assert [message.type for message in world.gcs.of("MISSION_ACK")] == [15]


def test_px4_tells_a_mission_id_that_changes_with_the_mission() -> None:
    world = World(Autopilot("px4"))
    world.companion.hello()
    world.on(1.5)
    world.autopilot.set_mission([item(0, 22, 0, 0, 0, 0, 0, 0, 10)])
    world.on(0.5)
    world.autopilot.set_mission([item(0, 22, 0, 0, 0, 0, 0, 0, 20)])
    world.on(0.5)
    payloads = [frame[10:-2] for frame in world.companion.frames if frame[7:10] == b"\x2a\x00\x00"]
    ids = changes(int.from_bytes(payload.ljust(18, b"\0")[6:10], "little") for payload in payloads)
    assert ids[0] == 0 and len(set(ids)) == 3


# PX4


def test_px4_repeats_a_command_until_it_is_acknowledged() -> None:
    mission = [item(0, 22, 0, 0, 0, 0, 0, 0, 5), item(1, 187, 0.5, frame=2), item(2, 93, 20, frame=2)]
    world = World(Autopilot("px4", mission=mission))
    world.companion.hello()
    world.autopilot.start_mission()
    world.on(15.0)
    sent = [message for message in world.companion.of("COMMAND_LONG") if message.command == 187]
    assert [message.confirmation for message in sent] == [0, 1, 2, 3]
    assert {(message.target_system, message.target_component) for message in sent} == {(1, 0)}


def test_a_burst_of_more_than_eight_items_loses_the_first() -> None:
    burst = [item(seq, 187, seq / 100, frame=2) for seq in range(1, 11)]
    mission = [item(0, 22, 0, 0, 0, 0, 0, 0, 5), *burst, item(11, 93, 20, frame=2)]
    world = World(Autopilot("px4", mission=mission))
    world.companion.hello()
    world.autopilot.start_mission()
    world.on(8.0)
    first = [m for m in world.companion.of("COMMAND_LONG") if m.command == 187 and m.confirmation == 0]
    assert [round(message.param1 * 100) for message in first] == list(range(3, 11))
    assert changes(message.seq for message in world.companion.of("MISSION_ITEM_REACHED")) == [10]


def test_px4_stops_rc_channels_when_rc_is_lost_and_flies_on() -> None:
    world = World(Autopilot("px4"))
    world.request_streams()
    world.autopilot.takeoff(30.0)
    world.on(2.0)
    assert len(world.companion.of("RC_CHANNELS")) == 20
    world.companion.forget()
    world.autopilot.lose_rc()
    world.on(3.0)
    assert world.companion.of("RC_CHANNELS") == []
    assert world.autopilot.mode_name == "TAKEOFF"
    world.autopilot.set_rc(9, 2000)
    world.autopilot.return_rc()
    world.on(0.1)
    assert world.companion.of("RC_CHANNELS")[0].chan9_raw == 2000


# Links


@pytest.mark.parametrize(
    ("kind", "kinds"), [("ardupilot", {"HEARTBEAT", "TIMESYNC"}), ("px4", {"HEARTBEAT"})]
)
def test_a_link_that_never_spoke_hears_little(kind: Kind, kinds: set[str]) -> None:
    world = World(Autopilot(kind))
    world.gcs.hello()
    world.autopilot.takeoff(5.0)
    world.gcs.say(mavlink.MAVLink_named_value_float_message(1, b"X", 1.0))
    world.on(20.5)
    assert {message.get_type() for _, message in world.companion.heard} == kinds
    assert len(world.companion.of("HEARTBEAT")) in (21, 22)


def test_ardupilot_does_itself_what_is_for_a_component_it_never_heard() -> None:
    world = World(Autopilot("ardupilot"))
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


def test_px4_ignores_a_command_for_a_component_it_never_heard() -> None:
    world = World(Autopilot("px4"))
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
    world = World(Autopilot("ardupilot"))
    world.gcs.hello()
    world.companion.hello()
    world.companion.say(mavlink.MAVLink_command_ack_message(31010, 0, 0, 0, *to))
    world.on(0.1)
    assert bool(world.gcs.of("COMMAND_ACK")) is arrives


@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
def test_named_values_and_texts_reach_the_ground_station_unchanged(kind: Kind) -> None:
    world = World(Autopilot(kind))
    world.gcs.hello()
    world.companion.hello()
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
    world = World(Autopilot("ardupilot"))
    world.request_streams()
    world.on(10.0)
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
    world = World(Autopilot("ardupilot"))
    world.companion.command(512, 148)
    world.companion.command(511, 12345, 1e6)
    world.companion.command(31010, 1)
    world.on(0.1)
    assert [message.result for message in world.companion.of("COMMAND_ACK")] == [0, 2, 3]
    assert len(world.companion.of("AUTOPILOT_VERSION")) == 1
    assert world.companion.texts() == ["No ap_message for mavlink id (12345)"]


def test_the_sequence_counts_up_per_link_without_a_gap() -> None:
    world = World(Autopilot("ardupilot"))
    world.request_streams()
    world.on(30.0)
    sequence = [frame[4] for frame in world.companion.frames]
    assert len(sequence) > 600
    assert sequence == [index % 256 for index in range(len(sequence))]


def test_a_reboot_is_silent_then_knows_nobody() -> None:
    world = World(Autopilot("ardupilot", mission=plan(TAKEOFF, LAND)))
    world.request_streams()
    world.on(5.0)
    before_ms = world.companion.of("RC_CHANNELS")[-1].time_boot_ms
    world.companion.forget()
    world.autopilot.reboot()
    world.on(1.2)
    assert world.companion.frames == []
    world.on(5.0)
    assert world.companion.frames[0][4] == 0
    assert {message.get_type() for _, message in world.companion.heard} == {"HEARTBEAT", "TIMESYNC"}
    world.request_streams()
    world.on(1.0)
    assert world.companion.of("RC_CHANNELS")[0].time_boot_ms < before_ms
    assert len(world.autopilot.items) == 3


def test_an_upload_right_after_boot_finds_no_space_and_ready_is_said_later() -> None:
    world = World(Autopilot("ardupilot"))
    world.autopilot.reboot()
    world.on(1.3)
    world.gcs.say(mavlink.MAVLink_mission_count_message(1, 1, 2))
    world.on(2.0)
    assert [message.type for message in world.gcs.of("MISSION_ACK")] == [4]
    assert world.gcs.texts() == ["ArduPilot Ready"]


def test_muted_links_carry_nothing_either_way_and_the_gap_shows() -> None:
    world = World(Autopilot("ardupilot"))
    world.request_streams()
    world.on(1.0)
    last = world.companion.frames[-1][4]
    world.companion.forget()
    world.autopilot.mute(3.0)
    world.companion.command(512, 148)
    world.on(2.9)
    assert world.companion.frames == []
    world.on(1.0)
    assert world.companion.of("COMMAND_ACK") == []
    assert (world.companion.frames[0][4] - last) % 256 > 20


# RC and stimuli


def test_without_a_receiver_since_boot_there_are_no_channels() -> None:
    world = World(Autopilot("ardupilot", rc_present=False))
    world.request_streams()
    world.on(1.0)
    channels = world.companion.of("RC_CHANNELS")[0]
    assert (channels.chancount, channels.chan9_raw) == (0, 0)
    assert not rc_health(world.companion.of("SYS_STATUS")[0])
    world.autopilot.set_rc(9, 2000)
    world.autopilot.return_rc()
    world.on(1.0)
    assert world.companion.of("RC_CHANNELS")[-1].chan9_raw == 2000
    assert rc_health(world.companion.of("SYS_STATUS")[-1])


def test_a_flight_may_go_on_after_rc_loss() -> None:
    world = World(Autopilot("ardupilot", mission=plan(TAKEOFF, (93, 30), LAND), rc_failsafe_mode=None))
    world.companion.hello()
    world.autopilot.start_mission()
    world.on(10.0)
    world.autopilot.lose_rc()
    world.on(2.0)
    assert "Radio Failsafe" in world.companion.texts()
    assert world.autopilot.mode_name == "AUTO"


def test_stimuli_that_make_no_sense_are_refused() -> None:
    autopilot = Autopilot("ardupilot")
    stimuli: list[Callable[[], None]] = [
        lambda: autopilot.set_mode("SIDEWAYS"),
        lambda: autopilot.set_rc(17, 1500),
        lambda: autopilot.set_rc(1, -1),
        lambda: autopilot.set_current(1),
        lambda: autopilot.lose_rc("silent"),
    ]
    for nonsense in stimuli:
        with pytest.raises(ValueError):
            nonsense()


def test_auto_without_a_mission_is_refused() -> None:
    world = World(Autopilot("ardupilot"))
    world.gcs.command(176, 1, 3)
    world.on(0.1)
    assert world.gcs.of("COMMAND_ACK")[0].result == 4
    assert world.autopilot.mode_name == "STABILIZE"


@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
def test_a_ground_station_flies_it_by_command(kind: Kind) -> None:
    world = World(Autopilot(kind))
    world.gcs.hello()
    if kind == "ardupilot":
        world.gcs.command(176, 1, 4)
    world.gcs.command(400, 1)
    world.gcs.command(22, 0, 0, 0, 0, 0, 0, 10)
    world.on(8.0)
    assert world.autopilot.height_m == pytest.approx(10.0)
    world.gcs.command(21)
    world.on(15.0)
    assert not world.autopilot.armed
    assert {message.result for message in world.gcs.of("COMMAND_ACK")} == {0}


def test_time_may_be_cut_in_any_way() -> None:
    def run(cuts: Sequence[float]) -> list[tuple[str, bytes]]:
        autopilot = Autopilot("ardupilot", mission=plan(TAKEOFF, WAYPOINT, (217, 1), (217, 2), (93, 1), LAND))
        frames = autopilot.advance(100.0)
        hello = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
        autopilot.receive(100.0, "companion", hello.pack(mavlink.MAVLink(None, 1, 191)))
        autopilot.start_mission()
        for cut in cuts:
            frames += autopilot.advance(100.0 + cut)
        return frames

    randomly = sorted(random.Random(7).uniform(0.0, 40.0) for _ in range(300))
    assert run([40.0]) == run([*randomly, 40.0])


# Whatever arrives


KINDS = st.sampled_from(["ardupilot", "px4"])
FLOATS = st.floats(width=32)


@settings(max_examples=150, deadline=None)
@given(KINDS, st.lists(st.binary(max_size=300), max_size=5))
def test_random_bytes_do_no_harm(kind: Kind, chunks: list[bytes]) -> None:
    autopilot = Autopilot(kind)
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


@settings(max_examples=150, deadline=None)
@given(KINDS, st.lists(st.tuples(st.integers(0, 200), st.integers(0, 255)), max_size=8))
def test_damaged_frames_do_no_harm(kind: Kind, damage: list[tuple[int, int]]) -> None:
    frames = bytearray(valid_frames())
    for at, byte in damage:
        frames[at % len(frames)] = byte
    autopilot = Autopilot(kind)
    autopilot.receive(0.0, "companion", bytes(frames))
    autopilot.advance(1.0)


BYTES = st.integers(0, 255)
COMMANDS = st.sampled_from([16, 20, 21, 22, 93, 112, 115, 176, 177, 183, 187, 211, 217, 224, 300, 400, 511])
MORE_COMMANDS = st.one_of(
    COMMANDS, st.sampled_from([512, 246, 530, 2000, 42600, 42702]), st.integers(0, 65535)
)
ADDRESS = st.sampled_from([(0, 0), (1, 0), (1, 1), (1, 191), (255, 190)])
SEVEN = st.tuples(FLOATS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS)


@st.composite
def strange_messages(draw: st.DrawFn) -> Any:
    to = draw(ADDRESS)
    which = draw(st.integers(0, 6))
    if which == 0:
        return mavlink.MAVLink_command_long_message(*to, draw(MORE_COMMANDS), draw(BYTES), *draw(SEVEN))
    if which == 1:
        x, y = draw(st.integers(-(2**31), 2**31 - 1)), draw(st.integers(-(2**31), 2**31 - 1))
        p1, p2, p3, p4, z, *_ = draw(SEVEN)
        return mavlink.MAVLink_command_int_message(*to, 3, draw(MORE_COMMANDS), 0, 0, p1, p2, p3, p4, x, y, z)
    if which == 2:
        head = (*to, draw(st.integers(0, 3)), draw(st.integers(0, 12)), draw(MORE_COMMANDS), 0, 1)
        return mavlink.MAVLink_mission_item_message(*head, *draw(SEVEN))
    if which == 3:
        return mavlink.MAVLink_mission_count_message(*to, draw(st.integers(0, 4)), mission_type=draw(BYTES))
    if which == 4:
        return mavlink.MAVLink_mission_request_message(*to, draw(st.integers(0, 5)))
    if which == 5:
        return mavlink.MAVLink_request_data_stream_message(*to, draw(BYTES), draw(st.integers(0, 65535)), 1)
    return mavlink.MAVLink_set_mode_message(1, 1, draw(st.sampled_from([3, 4, 6, 9, 67371008, 0])))


@settings(max_examples=250, deadline=None)
@given(KINDS, st.lists(strange_messages(), max_size=8), st.lists(SEVEN, min_size=1, max_size=3), COMMANDS)
def test_strange_messages_do_no_harm(
    kind: Kind, messages: list[Any], uploaded: list[tuple[float, ...]], command: int
) -> None:
    autopilot = Autopilot(kind)
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
