"""The complete vehicle side: the served autopilot, its requests, and its triggers."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config import config
from flying_vines.vehicle.mavlink.codec import MavlinkCodec, MavlinkMessage
from flying_vines.vehicle.mavlink.tlog import TlogReader
from flying_vines.vehicle.mission.item import MissionItem
from flying_vines.vehicle.notice import Notice
from flying_vines.vehicle.triggers import Trigger
from flying_vines.vehicle.vehicle import Vehicle
from flying_vines.vine.intent import BendTo, StartProfile, VentVine

RECORDINGS = Path(__file__).parents[1] / "data" / "recordings"
TICK_S = 0.02


class Link:
    """A vehicle behind a link: frames in, and all outputs, by kind."""

    def __init__(
        self, settings: config.Config | None = None, mission: list[MissionItem] | None = None
    ) -> None:
        self.vehicle = Vehicle(settings or config.default(), mission or [])
        self.codec = MavlinkCodec(0, 191)
        self.ticks = 0
        self.triggers: list[Trigger] = []
        self.notices: list[Notice] = []
        self.sent: list[tuple[float, MavlinkMessage]] = []
        self.items: dict[int, MavlinkMessage] = {}
        """The items that the autopilot sends on request."""
        self._senders: dict[tuple[int, int], mavlink.MAVLink] = {}

    @property
    def now_s(self) -> float:
        return self.ticks * TICK_S

    def receive(self, message: MavlinkMessage, system_id: int = 1, component_id: int = 1) -> None:
        sender = self._senders.setdefault(
            (system_id, component_id), mavlink.MAVLink(None, system_id, component_id)
        )
        frame = message.pack(sender)
        sender.seq = (sender.seq + 1) % 256
        self.receive_frame(self.now_s, frame)

    def receive_frame(self, t: float, frame: bytes) -> None:
        for message in self.codec.decode(frame):
            if message.get_type() == "MISSION_ITEM_INT":
                self.items[message.seq] = message
            self._sort(t, self.vehicle.handle(t, message))

    def _sort(self, t: float, outputs: list[Trigger | Notice | MavlinkMessage]) -> None:
        for output in outputs:
            if isinstance(output, Trigger):
                self.triggers.append(output)
            elif isinstance(output, Notice):
                self.notices.append(output)
            else:
                self.sent.append((t, output))
                if output.get_type() == "MISSION_REQUEST_INT" and output.seq in self.items:
                    self._sort(t, self.vehicle.handle(t, self.items[output.seq]))

    def wait(self, for_s: float) -> None:
        for _ in range(round(for_s / TICK_S)):
            self.ticks += 1
            self._sort(self.now_s, self.vehicle.tick(self.now_s))

    def run(self, for_s: float, switch_us: int, autopilot: int = 3, boot_ms: int = 0) -> None:
        """An autopilot that streams RC at 20 Hz and the rest at 5 Hz."""
        for i in range(round(for_s / 0.02)):
            if i % 50 == 0:
                self.receive(mavlink.MAVLink_heartbeat_message(2, autopilot, 0x80, 3, 4, 3))
            if i % 3 == 0:
                pulses_us = [1500, 1500, 1100, *(5 * [1500]), switch_us, *(9 * [0])]
                self.receive(mavlink.MAVLink_rc_channels_message(0, 16, *pulses_us, 255))
            if i % 10 == 0:
                self.receive(mavlink.MAVLink_system_time_message(0, boot_ms + int(self.now_s * 1000)))
            self.wait(0.02)

    def text(self, words: str) -> None:
        self.receive(mavlink.MAVLink_statustext_message(6, words.encode(), 0, 0))


def test_a_move_of_the_switch_starts_its_profile() -> None:
    link = Link()
    link.run(2.0, 1000)
    assert link.triggers == []
    link.run(1.0, 1500)
    link.run(1.0, 2000)
    assert [trigger.intent for trigger in link.triggers] == [
        StartProfile("bend-half"),
        StartProfile("bend-full"),
    ]
    assert all(trigger.by_person for trigger in link.triggers)


def test_a_position_without_a_profile_does_nothing() -> None:
    settings = config.default()
    switch = msgspec.structs.replace(settings.switch, positions=("straight", "", "bend-full"))
    link = Link(msgspec.structs.replace(settings, switch=switch))
    link.run(2.0, 1000)
    link.run(1.0, 1500)
    assert link.triggers == []
    link.run(1.0, 1000)
    assert [trigger.intent for trigger in link.triggers] == [StartProfile("straight")]


def test_a_move_while_the_radio_is_lost_is_only_reported() -> None:
    link = Link()
    link.run(2.0, 1000)
    link.text("Radio Failsafe")
    link.run(3.0, 2000)
    assert link.triggers == []
    link.text("Radio Failsafe Cleared")
    link.run(3.0, 2000)
    assert link.triggers == []
    texts = [notice.text for notice in link.notices]
    assert texts.count("Vine: switch ch9 moved while RC was lost, move it again") == 1


def test_after_a_loss_of_rc_a_new_move_is_needed() -> None:
    link = Link()
    link.run(2.0, 1000)
    link.wait(2.0)
    link.run(2.0, 2000)
    assert link.triggers == []


def test_two_autopilots_are_reported_and_neither_is_served() -> None:
    link = Link()
    link.receive(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3), 1)
    link.wait(0.5)
    link.receive(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3), 2)
    asked = len(link.sent)
    link.run(4.0, 1000)
    link.run(2.0, 2000)
    link.text("Mission: 3 Scripting")
    link.receive(mavlink.MAVLink_command_long_message(1, 191, 31011, 0, 20, 0, 0, 0, 0, 0, 0), 255, 190)
    link.wait(5.0)
    assert link.triggers == []
    assert len(link.sent) == asked
    assert "autopilots 1 and 2" in link.notices[-1].text


def test_nothing_is_sent_before_a_vehicle_is_found() -> None:
    link = Link()
    link.receive(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), 255, 190)
    link.receive(mavlink.MAVLink_command_long_message(1, 191, 31011, 0, 20, 0, 0, 0, 0, 0, 0), 255, 190)
    link.wait(10.0)
    assert link.sent == []
    assert link.notices == []
    assert link.triggers == []


def test_messages_of_a_second_vehicle_move_nothing() -> None:
    link = Link()
    link.run(4.0, 1000)
    for _ in range(40):
        link.receive(mavlink.MAVLink_rc_channels_message(0, 16, *(18 * [2000]), 255), 2)
        link.receive(mavlink.MAVLink_statustext_message(6, b"Mission: 3 Scripting", 0, 0), 2)
        link.receive(mavlink.MAVLink_rc_channels_message(0, 16, *(18 * [2000]), 255), 1, 154)
        link.run(0.06, 1000)
    assert link.triggers == []


@pytest.mark.parametrize("words", ["Radio Failsafe", "Mission: 3 Scripting", "ArduPilot Ready"])
def test_a_later_part_of_a_long_text_is_no_text_of_its_own(words: str) -> None:
    link = Link()
    link.run(4.0, 1000, boot_ms=100_000)
    link.receive(mavlink.MAVLink_statustext_message(6, 50 * b"a", 9, 0))
    link.receive(mavlink.MAVLink_statustext_message(6, words.encode(), 9, 1))
    link.wait(1.0)
    assert link.triggers == []
    assert link.vehicle.rc.problem(link.now_s - 1.0) is None


def test_a_reboot_vents_and_everything_is_requested_again() -> None:
    link = Link()
    link.run(5.0, 1000, boot_ms=100_000)
    assert {m.param1 for _, m in link.sent if m.get_type() == "COMMAND_LONG"} == {65, 1, 33, 42, 2, 29}
    link.sent.clear()
    link.text("ArduPilot Ready")
    assert [trigger.intent for trigger in link.triggers] == [VentVine()]
    link.wait(4.0)
    assert {m.param1 for _, m in link.sent if m.get_type() == "COMMAND_LONG"} == {65, 1, 33, 42, 2, 29}
    link.run(3.0, 2000)
    assert len(link.triggers) == 1  # the move to the present position was not seen


def test_missing_streams_are_named_once() -> None:
    link = Link()
    link.run(20.0, 1000)
    texts = [notice.text for notice in link.notices if "does not send" in notice.text]
    assert texts == ["Vine: the autopilot does not send SYS_STATUS, GLOBAL_POSITION_INT"]


@pytest.mark.parametrize(
    ("channels", "switch_us", "why"),
    [
        (None, 1000, "no RC_CHANNELS yet"),
        (8, 0, "channel 9 has no valid pulse (0)"),
        (16, 1000, None),
    ],
    ids=["the autopilot sends RC_CHANNELS_RAW only", "an autopilot of eight channels", "a good receiver"],
)
def test_a_switch_that_does_nothing_is_told_once_after_arming(
    channels: int | None, switch_us: int, why: str | None
) -> None:
    link = Link()
    for step in range(120):
        armed = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if step >= 40 else 0
        if step % 5 == 0:
            link.receive(mavlink.MAVLink_heartbeat_message(2, 3, armed, 0, 4, 3))
        if channels:
            pulses = [1500] * 8 + [switch_us] + [0] * 9
            link.receive(mavlink.MAVLink_rc_channels_message(step * 200, channels, *pulses, 255))
        link.wait(0.2)
        if step == 40:
            assert not [notice for notice in link.notices if "switch" in notice.text]
    told = [notice.text for notice in link.notices if "switch" in notice.text]
    assert told == ([f"Vine: switch ch9 does nothing: {why}"] if why else [])


def test_one_execution_of_an_ardupilot_item_is_one_trigger() -> None:
    settings = config.default()
    camera = config.ItemConfig(command=203, bend="param1", scale=1.0)
    settings = msgspec.structs.replace(settings, items=(camera, *settings.items))
    items = [MissionItem(seq, 16, (0,) * 7) for seq in range(3)]
    items += [MissionItem(3, 203, (12.0, 0, 0, 0, 0, 0, 0)), MissionItem(4, 16, (0,) * 7)]
    link = Link(settings, items)
    link.run(1.0, 1000)
    # As with a camera of type MAVLink: all components get the command, and the text comes too.
    link.receive(mavlink.MAVLink_command_long_message(0, 0, 203, 0, 12.0, 0, 0, 0, 0, 0, 0))
    link.text("Mission: 3 DigiCamCtrl")
    link.run(5.0, 1000)
    assert [trigger.intent for trigger in link.triggers] == [BendTo(12.0)]


def test_timesync_is_answered_to_our_autopilot_only() -> None:
    link = Link()
    link.run(0.1, 1000)
    link.receive(mavlink.MAVLink_timesync_message(0, 77), 2)
    link.receive(mavlink.MAVLink_timesync_message(0, 99))
    assert [m.ts1 for _, m in link.sent if m.get_type() == "TIMESYNC" and m.tc1] == [99]


EXECUTIONS = {
    "ardupilot_vine_mission": [(25.778, 3, 217), (36.272, 5, 211), (44.409, 7, 217), (51.228, 9, 217)],
    "px4_vine_mission": [(29.267, 2, 187), (36.792, 4, 211), (44.706, 6, 42600), (53.211, 8, 187)],
}


def replayed(name: str, drop: set[int] | None = None, twice: bool = False) -> Link:
    link, began = Link(), None
    for i, (unix_s, frame) in enumerate(TlogReader(RECORDINGS / f"{name}.tlog").frames()):
        began = unix_s if began is None else began
        while link.now_s + TICK_S <= unix_s - began:
            link.wait(TICK_S)
        if drop is None or i not in drop:
            link.receive_frame(unix_s - began, frame)
            if twice:
                link.receive_frame(unix_s - began, frame)
    link.wait(5.0)
    return link


@pytest.mark.parametrize("name", EXECUTIONS)
@pytest.mark.parametrize("twice", [False, True])
def test_each_item_of_a_real_flight_is_found_once(name: str, twice: bool) -> None:
    link = replayed(name, twice=twice)
    found = [(trigger.t, trigger.what["seq"], trigger.what["command"]) for trigger in link.triggers]
    assert [(seq, number) for _, seq, number in found] == [(s, n) for _, s, n in EXECUTIONS[name]]
    for (t, _, _), (at_s, _, _) in zip(found, EXECUTIONS[name], strict=True):
        assert t == pytest.approx(at_s, abs=0.02)


def test_the_items_of_a_real_flight_are_found_without_any_text() -> None:
    frames = [frame for _, frame in TlogReader(RECORDINGS / "ardupilot_vine_mission.tlog").frames()]
    drop = {i for i, frame in enumerate(frames) if b"Mission: " in frame}
    assert len(drop) >= 12
    link = replayed("ardupilot_vine_mission", drop)
    found = [(trigger.t, trigger.what["seq"]) for trigger in link.triggers]
    assert [seq for _, seq in found] == [seq for _, seq, _ in EXECUTIONS["ardupilot_vine_mission"]]
    for (t, _), (at_s, _, _) in zip(found, EXECUTIONS["ardupilot_vine_mission"], strict=True):
        assert at_s < t < at_s + 2.0


def test_two_reboots_of_a_real_autopilot_are_each_seen_once() -> None:
    link = replayed("reboot")
    reboots = [trigger.t for trigger in link.triggers if trigger.kind == "link"]
    assert reboots == pytest.approx([22.71, 52.76], abs=0.05)
    moves = [(trigger.t, trigger.what["position"]) for trigger in link.triggers if trigger.kind == "switch"]
    assert [position for _, position in moves] == [2, 0]
    assert [t for t, _ in moves] == pytest.approx([12.25, 45.3], abs=0.15)


def test_another_mission_of_the_same_length_is_reported_with_the_executed_item() -> None:
    link = Link()
    link.run(1.0, 1000)
    read = [mission_item(0, 16), mission_item(1, 22), mission_item(2, 217, 1.0, 11.0)]
    link.receive(mavlink.MAVLink_mission_count_message(1, 191, 3, 0))
    for message in read:
        link.receive(message)
    link.run(1.0, 1000)
    link.items.clear()
    link.text("Mission: 2 Scripting")
    link.run(0.1, 1000)
    assert link.triggers == []
    link.receive(mission_item(2, 217, 1.0, 44.0))
    link.run(0.1, 1000)
    assert [(trigger.intent, trigger.what["params"]) for trigger in link.triggers] == [
        (BendTo(44.0), [1.0, 44.0, 0.0, 0.0])
    ]
    link.run(1.0, 1000)
    link.receive(mavlink.MAVLink_mission_count_message(1, 191, 3, 0))
    for message in (*read[:2], mission_item(2, 217, 1.0, 44.0)):
        link.receive(message)
    texts = [notice.text for notice in link.notices if "mission changed" in notice.text]
    assert texts == ["Vine: mission changed, item 2: bend 44°"]


def mission_item(seq: int, command: int, param1: float = 0.0, param2: float = 0.0) -> MavlinkMessage:
    return mavlink.MAVLink_mission_item_int_message(
        1, 191, seq, 0, command, 0, 1, param1, param2, 0, 0, 0, 0, 0, 0
    )


def test_a_button_pressed_before_a_stall_has_its_true_age() -> None:
    link = Link()
    link.run(5.0, 1000, boot_ms=100_000)
    stopped_at = link.now_s
    link.wait(7.0)
    bend = mavlink.MAVLink_command_long_message(1, 191, 31011, 0, 30.0, 0, 0, 0, 0, 0, 0)
    link.receive(bend, 255, 190)
    assert link.triggers == []
    boot_ms = 100_000 + int(1000 * (stopped_at + 0.5))
    link.receive(mavlink.MAVLink_system_time_message(0, boot_ms))
    (trigger,) = link.triggers
    assert trigger.age_s == pytest.approx(6.5, abs=0.1)
    assert trigger.what["late_s"] == pytest.approx(6.5, abs=0.1)
