"""The script for ArduPilot in the same version of Lua, with a stand-in for ArduPilot's interface."""

from __future__ import annotations

import os
import struct
from collections import deque
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config import config
from flying_vines.vehicle.mavlink.codec import MavlinkCodec, MavlinkMessage
from flying_vines.vehicle.mission.item import MissionItem
from flying_vines.vehicle.triggers import Trigger
from flying_vines.vehicle.vehicle import Vehicle

try:
    from lupa import lua53  # type: ignore[import-untyped]
except ImportError:
    if os.environ.get("CI"):
        raise
    pytest.skip("the Lua script is tested with lupa: pip install lupa", allow_module_level=True)

SCRIPT = (Path(__file__).parents[2] / "missions" / "ardupilot" / "vine_items.lua").read_bytes()
US, TELEMETRY = 2, 0
"""The channels of the companion and of a ground station."""

STAND_IN = b"""
local host = ...
local uint32 = {}
uint32.__index = uint32
local function new(value) return setmetatable({value = value & 0xFFFFFFFF}, uint32) end
uint32.__sub = function(a, b) return new(a.value - b.value) end
uint32.toint = function(self) return self.value end
function millis() return new(host.millis()) end
function mission_receive()
  local item = host.mission_receive()
  if item then return new(item[0]), item[1], item[2], item[3], item[4] end
end
gcs = {send_text = function(_, severity, text) host.send_text(severity, text) end}
mavlink = {
  init = function(_, a, b) assert(a == b) end,
  register_rx_msgid = function(_, id) host.register(id) return true end,
  receive_chan = function()
    local received = host.receive()
    if received then return received[0], received[1], new(received[2]) end
  end,
  send_chan = function(_, chan, id, payload) return host.send(chan, id, payload) end,
}
param = {
  add_table = function() return true end,
  add_param = function(_, key, index, name, default) host.add_param(name, default) return true end,
  get = function(_, name) return host.get(name) end,
}
function Parameter(name) return {get = function() return host.get(name) end} end
"""


class ArduPilot:
    """The part of ArduPilot that the script uses; times are its milliseconds."""

    def __init__(self, **params: float) -> None:
        self.now_ms = 4_294_967_295 - 3_000  # the 32-bit clock wraps during the test
        self.params: dict[str, float] = {"SYSID_THISMAV": 1.0}
        self.texts: list[str] = []
        self.sent: list[tuple[int, MavlinkMessage]] = []
        self.items: deque[tuple[int, int, float, float, float]] = deque()
        self.received: deque[tuple[bytes, int, int]] = deque()
        self.registered: set[int] = set()
        self.has_room = True
        self.broken = False
        self._side = mavlink.MAVLink(None, 1, 1)
        lua = lua53.LuaRuntime(encoding=None, unpack_returned_tuples=False)
        lua.eval(b"function(code, ...) return load(code)(...) end")(STAND_IN, self)
        self._next: Any = lua.compile(SCRIPT)
        self.params |= params
        self.interval_ms = 0
        self.run(1)

    # Functions that the script calls.

    def millis(self) -> int:
        if self.broken:
            raise RuntimeError("out of order")
        return self.now_ms & 0xFFFFFFFF

    def mission_receive(self) -> tuple[int, int, float, float, float] | None:
        return self.items.popleft() if self.items else None

    def send_text(self, severity: int, text: bytes) -> None:
        self.texts.append(text.decode())

    def register(self, message_id: int) -> None:
        self.registered.add(message_id)

    def receive(self) -> tuple[bytes, int, int] | None:
        return self.received.popleft() if self.received else None

    def add_param(self, name: bytes, default: float) -> None:
        self.params.setdefault("VINE_" + name.decode(), default)

    def get(self, name: bytes) -> float | None:
        return self.params.get(name.decode())

    def send(self, channel: int, message_id: int, payload: bytes) -> bool:
        assert channel in (US, TELEMETRY), "older releases crash here"
        if not self.has_room:
            return False
        kind = mavlink.mavlink_map[message_id]
        assert len(payload) == kind.unpacker.size
        message = mavlink.MAVLink(None)
        header = struct.pack("<BBBBBBBHB", 0xFD, len(payload), 0, 0, 0, 1, 1, message_id, 0)
        crc = mavlink.x25crc(header[1:] + payload)
        crc.accumulate(bytes((kind.crc_extra,)))
        self.sent.append((channel, message.parse_char(header + payload + struct.pack("<H", crc.crc))))
        return True

    # Events.

    def run(self, for_ms: int) -> None:
        end_ms = self.now_ms + for_ms
        while self.now_ms < end_ms:
            if self.interval_ms <= 0:
                self._next, self.interval_ms = self._next()
            step_ms = min(self.interval_ms, end_ms - self.now_ms)
            self.now_ms += step_ms
            self.interval_ms -= step_ms

    def item(self, p1: int, p2: float = 0.0, p3: float = 0.0, p4: float = 0.0) -> None:
        """A script message begins to run."""
        if len(self.items) < 5:
            self.items.append((self.now_ms & 0xFFFFFFFF, p1, p2, p3, p4))

    def deliver(
        self, message: MavlinkMessage, system: int = 1, component: int = 191, channel: int = US
    ) -> None:
        """A message arrives. The script gets ArduPilot's own structure of it."""
        if message.get_msgId() not in self.registered:
            return
        packed = message.pack(mavlink.MAVLink(None, system, component))
        payload = packed[10:-2].ljust(264, b"\0")
        head = struct.pack("<HBBBBBBB", 0, 0xFD, packed[1], 0, 0, 0, system, component)
        structure = head + struct.pack("<I", message.get_msgId())[:3] + payload + bytes(2 + 13)
        assert len(structure) == 291
        self.received.append((structure, channel, self.now_ms & 0xFFFFFFFF))

    def deliver_heartbeat(self) -> None:
        self.deliver(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 3, 3))
        self.run(20)

    def acknowledge(self, command: int = 31010, component: int = 191) -> None:
        self.deliver(mavlink.MAVLink_command_ack_message(command, 0, 0, 0, 1, 1), component=component)
        self.run(20)

    def commands(self) -> list[tuple[float, ...]]:
        """Target and numbers of the sent commands, without repeats."""
        return [
            (m.target_system, m.target_component, m.command, m.param1, m.param2, m.param3, m.param4)
            for _, m in self.sent
            if m.confirmation == 0
        ]


@pytest.fixture
def autopilot() -> ArduPilot:
    autopilot = ArduPilot()
    autopilot.deliver_heartbeat()
    return autopilot


def test_it_reports_that_it_runs(autopilot: ArduPilot) -> None:
    assert autopilot.texts == ["Vine: script runs"]
    assert autopilot.sent == []


def test_an_item_goes_to_the_companion_at_once_and_exactly(autopilot: ArduPilot) -> None:
    third = struct.unpack("<f", struct.pack("<f", 1 / 3))[0]
    autopilot.item(65535, -2.25, third, 1e-30)
    autopilot.run(20)
    (tiny,) = struct.unpack("<f", struct.pack("<f", 1e-30))
    assert autopilot.commands() == [(1, 191, 31010, 65535.0, -2.25, third, tiny)]
    assert [channel for channel, _ in autopilot.sent] == [US]


def test_it_is_repeated_until_it_is_acknowledged(autopilot: ArduPilot) -> None:
    autopilot.item(1, 40.0)
    autopilot.run(1200)
    assert [m.confirmation for _, m in autopilot.sent] == [0, 1, 2]
    assert len({(m.param1, m.param2, m.param5) for _, m in autopilot.sent}) == 1
    autopilot.acknowledge()
    autopilot.run(5000)
    assert len(autopilot.sent) == 3
    assert autopilot.texts == ["Vine: script runs"]


def test_without_an_answer_it_gives_up_and_reports_it(autopilot: ArduPilot) -> None:
    autopilot.item(1, 40.0)
    autopilot.run(10_000)
    assert [m.confirmation for _, m in autopilot.sent] == [0, 1, 2, 3]
    assert autopilot.texts[1:] == ["Vine: component 191 does not answer"]


def test_items_in_a_row_go_one_after_another_each_with_its_own_number(autopilot: ArduPilot) -> None:
    for angle_deg in (10.0, 20.0, 20.0):
        autopilot.item(1, angle_deg)
        autopilot.run(6)
    for _ in range(3):
        autopilot.run(20)
        autopilot.acknowledge()
    assert [command[4] for command in autopilot.commands()] == [10.0, 20.0, 20.0]
    assert len({m.param5 for _, m in autopilot.sent}) == 3


def test_acknowledgements_of_others_and_of_other_commands_are_not_for_it(autopilot: ArduPilot) -> None:
    autopilot.item(1, 40.0)
    autopilot.run(20)
    autopilot.acknowledge(component=154)
    autopilot.acknowledge(command=400)
    autopilot.deliver(mavlink.MAVLink_command_ack_message(31010, 0, 0, 0, 1, 1), system=2)
    autopilot.run(600)
    assert [m.confirmation for _, m in autopilot.sent] == [0, 1]


def test_an_answer_to_a_ground_station_is_not_for_it(autopilot: ArduPilot) -> None:
    autopilot.item(1, 40.0)
    autopilot.run(20)
    for system, component in ((255, 190), (1, 154)):
        autopilot.deliver(mavlink.MAVLink_command_ack_message(31010, 0, 0, 0, system, component))
    autopilot.run(600)
    assert [m.confirmation for _, m in autopilot.sent] == [0, 1]


def test_the_answer_to_a_repeat_does_not_remove_the_next_item(autopilot: ArduPilot) -> None:
    for angle_deg in (10.0, 20.0):
        autopilot.item(1, angle_deg)
    autopilot.run(600)
    assert [(m.param2, m.confirmation) for _, m in autopilot.sent] == [(10.0, 0), (10.0, 1)]
    for _ in range(2):
        autopilot.deliver(mavlink.MAVLink_command_ack_message(31010, 0, 0, 0, 1, 1))
    autopilot.run(600)
    assert [(m.param2, m.confirmation) for _, m in autopilot.sent[2:]] == [(20.0, 0), (20.0, 1)]


def test_nothing_is_sent_before_a_message_of_the_companion() -> None:
    autopilot = ArduPilot()
    autopilot.deliver(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), 255, 190, TELEMETRY)
    autopilot.deliver(mavlink.MAVLink_heartbeat_message(26, 8, 0, 0, 4, 3), 1, 154, TELEMETRY)
    autopilot.item(1, 40.0)
    autopilot.run(500)
    assert autopilot.sent == []
    autopilot.deliver_heartbeat()
    assert [(channel, m.param2) for channel, m in autopilot.sent] == [(US, 40.0)]


def test_an_old_item_is_not_sent() -> None:
    autopilot = ArduPilot()
    autopilot.item(1, 40.0)
    autopilot.run(3000)
    autopilot.deliver_heartbeat()
    autopilot.run(3000)
    assert autopilot.sent == []
    assert autopilot.texts[1:] == ["Vine: component 191 does not answer"]


def test_a_full_link_is_tried_again_soon(autopilot: ArduPilot) -> None:
    autopilot.has_room = False
    autopilot.item(1, 40.0)
    autopilot.run(300)
    autopilot.has_room = True
    autopilot.run(20)
    assert [m.confirmation for _, m in autopilot.sent] == [0]


def test_component_channel_and_system_are_parameters() -> None:
    autopilot = ArduPilot(VINE_COMP=25.0, VINE_CHAN=0.0, MAV_SYSID=7.0)
    autopilot.item(1, 40.0)
    autopilot.run(20)
    assert autopilot.commands() == [(7, 25, 31010, 1.0, 40.0, 0.0, 0.0)]
    assert [channel for channel, _ in autopilot.sent] == [TELEMETRY]


def test_an_error_does_not_end_it(autopilot: ArduPilot) -> None:
    autopilot.broken = True
    autopilot.item(1, 40.0)
    autopilot.run(2500)
    assert len(autopilot.texts) in (3, 4)
    assert "out of order" in autopilot.texts[1]
    autopilot.broken = False
    autopilot.run(1000)
    autopilot.item(2, 0.0)
    autopilot.run(20)
    assert autopilot.commands()[-1][3] == 2.0


def test_the_service_makes_one_bend_of_text_command_and_repeats(autopilot: ArduPilot) -> None:
    mission = [MissionItem(3, 217, (1.0, 40.0, 0.0, 0.0, 0.0, 0.0, 0.0))]
    vehicle, codec, side = Vehicle(config.default(), mission), MavlinkCodec(1, 191), MavlinkCodec(1, 1)
    triggers: list[Trigger] = []
    answers: list[MavlinkMessage] = []

    def tell(t: float, message: MavlinkMessage) -> None:
        for received in codec.decode(side.encode(message, 1)):
            for output in vehicle.handle(t, received):
                if isinstance(output, Trigger):
                    triggers.append(output)
                    answers.extend(vehicle.acknowledge(output, True))
                elif hasattr(output, "get_type") and output.get_type() == "COMMAND_ACK":
                    answers.append(output)

    for second in range(4):
        tell(second, mavlink.MAVLink_heartbeat_message(2, 3, 217, 3, 4, 3))
        tell(second, mavlink.MAVLink_system_time_message(0, 1000 * second))
    for pass_at_s in (3.5, 5.0):  # the same numbers again, after a jump
        tell(pass_at_s, mavlink.MAVLink_statustext_message(6, b"Mission: 3 Scripting"))
        sent_before = len(autopilot.sent)
        autopilot.item(1, 40.0)
        autopilot.run(1100)
        for i, (_, command) in enumerate(autopilot.sent[sent_before:]):
            tell(pass_at_s + 0.01 + 0.5 * i, command)
        autopilot.acknowledge()
    assert [str(trigger.intent) for trigger in triggers] == ["bend 40°", "bend 40°"]
    assert [answer.get_type() for answer in answers] == ["COMMAND_ACK"] * len(autopilot.sent)
