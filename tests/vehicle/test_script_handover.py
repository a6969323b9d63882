"""A script on ArduPilot sends an item that a status text also reports: it is executed once."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config import config
from flying_vines.vehicle.mavlink.codec import MavlinkCodec, MavlinkMessage
from flying_vines.vehicle.mission.item import MissionItem
from flying_vines.vehicle.triggers import Trigger
from flying_vines.vehicle.vehicle import Vehicle

MISSION = [MissionItem(3, 217, (1.0, 40.0, 0.0, 0.0, 0.0, 0.0, 0.0))]
TEXT = mavlink.MAVLink_statustext_message(6, b"Mission: 3 Scripting")


def handed(angle_deg: float = 40.0) -> MavlinkMessage:
    return mavlink.MAVLink_command_long_message(1, 191, 31010, 0, 1.0, angle_deg, 0, 0, 0, 0, 0)


class Link:
    """An ArduPilot's messages, as they arrive."""

    def __init__(self, mission: list[MissionItem]) -> None:
        self.vehicle = Vehicle(config.default(), mission)
        self._autopilot, self._codec = MavlinkCodec(1, 1), MavlinkCodec(1, 191)
        self.triggers: list[Trigger] = []
        self.answers: list[int] = []
        self._stamped_at = -1.0

    def send(self, t: float, message: MavlinkMessage) -> None:
        while self._stamped_at < t - 1.0:
            self._stamped_at += 1.0
            self._take(self._stamped_at, mavlink.MAVLink_heartbeat_message(2, 3, 217, 3, 4, 3))
            boot_ms = int(60_000 + 1000 * self._stamped_at)
            self._take(self._stamped_at, mavlink.MAVLink_system_time_message(0, boot_ms))
        self._take(t, message)

    def _take(self, t: float, message: MavlinkMessage) -> None:
        for received in self._codec.decode(self._autopilot.encode(message, 1)):
            self._keep(self.vehicle.handle(t, received))

    def wait(self, until_t: float) -> None:
        for tick in range(int(until_t * 50)):
            self._keep(self.vehicle.tick(tick / 50))

    def _keep(self, outputs: list[MavlinkMessage]) -> None:
        for output in outputs:
            if isinstance(output, Trigger):
                self.triggers.append(output)
                self._keep(list(self.vehicle.acknowledge(output, True)))
            elif hasattr(output, "get_type") and output.get_type() == "COMMAND_ACK":
                self.answers.append(output.result)

    @property
    def intents(self) -> list[str]:
        return [str(trigger.intent) for trigger in self.triggers]


@pytest.mark.parametrize("mission", [MISSION, []], ids=["mission read", "mission not read"])
@pytest.mark.parametrize("order", ["text first", "command first"])
def test_one_item_is_one_trigger(mission: list[MissionItem], order: str) -> None:
    link = Link(mission)
    first, second = (TEXT, handed()) if order == "text first" else (handed(), TEXT)
    link.send(5.0, first)
    link.send(5.012, second)
    link.wait(9.0)
    assert link.intents == ["bend 40°"]
    assert link.answers == [mavlink.MAV_RESULT_ACCEPTED]


def test_without_a_script_the_text_is_refused_because_it_has_no_numbers() -> None:
    link = Link([])
    link.send(5.0, TEXT)
    link.wait(9.0)
    assert [trigger.intent for trigger in link.triggers] == [None]
    assert "not confirmed" in link.triggers[0].problem


def test_the_script_alone_is_enough() -> None:
    link = Link([])
    link.send(5.0, handed())
    link.wait(9.0)
    assert link.intents == ["bend 40°"]


def test_other_numbers_are_another_item() -> None:
    link = Link(MISSION)
    link.send(5.0, TEXT)
    link.send(5.01, handed(15.0))
    link.wait(9.0)
    assert link.intents == ["bend 40°", "bend 15°"]


def test_a_second_pass_counts_again() -> None:
    link = Link(MISSION)
    for t in (5.0, 25.0):
        link.send(t, TEXT)
        link.send(t + 0.01, handed())
    assert link.intents == ["bend 40°", "bend 40°"]
    assert len(link.answers) == 2
