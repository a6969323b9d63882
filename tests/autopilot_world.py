"""A simulated autopilot between a companion and a ground station, and recordings of real ones."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.simulation.autopilot import FakeAutopilot
from flying_vines.vehicle.mission.item import MissionItem, has_place

RECORDINGS = Path(__file__).parent / "data" / "recordings"

RC_RECEIVER = 0x10000
STREAMS_HZ = {65: 10, 1: 2, 33: 5, 30: 5, 74: 5, 42: 2, 2: 1}

Received = tuple[float, Any]


class Peer:
    """A sender on a link. It stores the autopilot's messages."""

    def __init__(self, world: World, link: str, system: int, component: int, kind: int) -> None:
        self.world = world
        self.link = link
        self.kind = kind
        self.received: list[Received] = []
        self.frames: list[bytes] = []
        self._mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        self._decoder = mavlink.MAVLink(None)

    def say(self, message: Any) -> None:
        frame = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        self.world.autopilot.receive(self.world.t, self.link, bytes(frame))

    def hello(self) -> None:
        self.say(mavlink.MAVLink_heartbeat_message(self.kind, 8, 0, 0, 4, 3))

    def command(self, command: int, *params: float, to: tuple[int, int] = (1, 1)) -> None:
        seven = (*params, *(0.0,) * (7 - len(params)))
        self.say(mavlink.MAVLink_command_long_message(*to, command, 0, *seven))

    def download(self, count: int) -> None:
        self.say(mavlink.MAVLink_mission_request_list_message(1, 1))
        for seq in range(count):
            self.say(mavlink.MAVLink_mission_request_int_message(1, 1, seq))

    def receive(self, frame: bytes) -> None:
        self.frames.append(frame)
        for message in self._decoder.parse_buffer(frame) or []:
            self.received.append((self.world.t, message))

    def of(self, *names: str) -> list[Any]:
        return [message for _, message in self.received if message.get_type() in names]

    def texts(self) -> list[str]:
        return [message.text for message in self.of("STATUSTEXT")]

    def forget(self) -> None:
        self.received.clear()
        self.frames.clear()


class World:
    """An autopilot, a companion and a ground station, and the simulated time."""

    def __init__(self, autopilot: FakeAutopilot, answer: Callable[[Peer, Any], None] | None = None) -> None:
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
                before = len(peer.received)
                peer.receive(frame)
                if self._answer is not None:
                    for _, message in peer.received[before:]:
                        self._answer(peer, message)

    def on(self, seconds: float) -> None:
        self.to(self.t + seconds)

    def request_streams(self, rates_hz: Mapping[int, float] = STREAMS_HZ) -> None:
        self.companion.hello()
        for message_id, rate_hz in rates_hz.items():
            self.companion.command(511, message_id, 1e6 / rate_hz)


def meeting(autopilot: FakeAutopilot) -> World:
    """Companion and ground station have said hello."""
    world = World(autopilot)
    world.gcs.hello()
    world.companion.hello()
    world.on(0.1)
    return world


def upload(items: Sequence[MissionItem]) -> Callable[[Peer, Any], None]:
    """Answers requests for items as a ground station does during an upload."""

    def answer(peer: Peer, message: Any) -> None:
        if peer.link != "gcs" or message.get_type() not in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
            return
        item = items[message.seq]
        scale = 1e7 if has_place(item.command, item.frame) else 1.0
        x, y = round(item.params[4] * scale), round(item.params[5] * scale)
        head = (1, 1, item.seq, item.frame, item.command, 0, 1)
        peer.say(mavlink.MAVLink_mission_item_int_message(*head, *item.params[:4], x, y, item.params[6]))

    return answer


def recording(name: str) -> list[Received]:
    """The autopilot's messages of a .tlog, with the time since the first frame."""
    data = (RECORDINGS / f"{name}.tlog").read_bytes()
    decoder = mavlink.MAVLink(None)
    decoder.robust_parsing = True
    received: list[Received] = []
    first_us, at = -1, 0
    while at < len(data):
        (unix_us,) = struct.unpack_from(">Q", data, at)
        length = 12 + data[at + 9] + (13 if data[at + 10] & 1 else 0)
        first_us = unix_us if first_us < 0 else first_us
        for message in decoder.parse_buffer(data[at + 8 : at + 8 + length]) or []:
            if message.get_srcComponent() == 1:
                received.append(((unix_us - first_us) / 1e6, message))
        at += 8 + length
    return received


def changes(values: Iterable[Any]) -> list[Any]:
    """The values without consecutive repeats."""
    return [value for value, _ in groupby(values)]


def timed_changes(
    received: Iterable[Received], name: str, view: Callable[[Any], object]
) -> list[tuple[float, object]]:
    out: list[tuple[float, object]] = []
    for t, message in received:
        if message.get_type() == name and (not out or out[-1][1] != view(message)):
            out.append((t, view(message)))
    return out


def parameter_bytes(message: Any) -> bytes:
    """The value of a MAVLink 2 PARAM_VALUE as bytes; pymavlink decodes them as a float."""
    frame = bytes(message.get_msgbuf())
    assert frame[0] == 0xFD and frame[1] >= 4
    return frame[10:14]


def rc_values(message: Any) -> tuple[int, ...]:
    channels = tuple(getattr(message, f"chan{channel}_raw") for channel in range(1, 19))
    return (*channels, message.chancount, message.rssi)


def rc_health(message: Any) -> bool:
    return bool(message.onboard_control_sensors_health & RC_RECEIVER)


def heartbeat(message: Any) -> tuple[int, int, int]:
    return message.base_mode, message.custom_mode, message.system_status


def mission_events(received: Iterable[Received]) -> list[str | int]:
    """Status texts and reached items in order, without texts that only the simulator or the EKF sends."""
    events: list[str | int] = []
    for _, message in received:
        if message.get_type() == "STATUSTEXT" and not message.text.startswith(("EKF3", "SIM ")):
            events.append(message.text)
        elif message.get_type() == "MISSION_ITEM_REACHED":
            events.append(message.seq)
    return events


def home() -> MissionItem:
    return MissionItem(0, 16, (0.0,) * 7)


def item(seq: int, command: int, *params: float, frame: int = 3) -> MissionItem:
    p1, p2, p3, p4, x, y, z = (*params, *(0.0,) * (7 - len(params)))
    return MissionItem(seq, command, (p1, p2, p3, p4, x, y, z), frame)


def plan(*commands: tuple[float, ...]) -> list[MissionItem]:
    """Home, then the given (command, param1, …) in order."""
    return [home(), *(item(seq, int(c[0]), *c[1:]) for seq, c in enumerate(commands, start=1))]


TAKEOFF = (22, 0, 0, 0, 0, 0, 0, 5)
WAYPOINT = (16, 0, 0, 0, 0, -35.3631, 149.165237, 5)
LAND = (21,)


def flown(mission: list[MissionItem], seconds: float = 60.0) -> World:
    world = World(FakeAutopilot("ardupilot", mission=mission))
    world.companion.hello()
    world.autopilot.start_mission()
    world.on(seconds)
    return world
