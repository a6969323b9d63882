"""The lines of `mission watch` for given messages."""

from __future__ import annotations

from typing import Any

from flying_vines.vehicle.mission.item import MissionItem
from missions.link import ReceivedMessage
from missions.watch import MissionView

MISSION = [
    MissionItem(0, 16, (0.0, 0.0, 0.0, 0.0, 47.0, 8.0, 500.0)),
    MissionItem(1, 22, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 12.0), 3),
    MissionItem(2, 16, (0.0, 0.0, 0.0, 0.0, 47.001, 8.0, 12.0), 3),
    MissionItem(3, 217, (1.0, 40.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
    MissionItem(4, 21, (0.0,) * 7, 3),
]


class Watched:
    """A view and its lines."""

    def __init__(self) -> None:
        self.view = MissionView(MISSION)
        self.lines: list[str] = []
        self.t = 0.0

    def receive(self, kind: str, component: int = 1, /, **fields: Any) -> None:
        self.t += 0.1
        message = ReceivedMessage(kind, component, fields)
        self.lines += [line.text for line in self.view.handle(self.t, message)]

    def heartbeat(self, armed: bool) -> None:
        self.receive("HEARTBEAT", base_mode=128 if armed else 0)

    def current(self, seq: int, state: int = 3) -> None:
        self.receive("MISSION_CURRENT", seq=seq, mission_state=state)

    def text(self, text: str, component: int = 1, severity: int = 6, **more: int) -> None:
        self.receive("STATUSTEXT", component, text=text, severity=severity, **more)


def test_each_item_of_ardupilot_is_shown_once() -> None:
    watched = Watched()
    watched.heartbeat(False)
    watched.text("Mission: 1 Takeoff")
    watched.current(1)
    watched.heartbeat(True)
    watched.current(2)
    watched.text("Mission: 2 WP")
    watched.receive("MISSION_ITEM_REACHED", seq=2)
    watched.text("Reached command #2")
    watched.text("Mission: 3 Scripting")
    watched.text("Mission: 4 Land")
    watched.current(4)
    assert not watched.view.ended
    watched.text("Disarming motors")
    assert watched.view.ended
    watched.text("Mission: 1 Takeoff")
    assert watched.lines == [
        "item 1: take-off",
        "armed",
        "item 2: waypoint",
        "item 2 reached",
        "item 3: script message (1, 40)",
        "item 4: land",
        "autopilot: Disarming motors",
    ]


def test_an_item_for_which_px4_sends_only_reached_is_shown() -> None:
    watched = Watched()
    watched.current(2)
    for _ in range(3):
        watched.receive("MISSION_ITEM_REACHED", seq=3)
    watched.current(4)
    watched.current(4, state=5)
    assert watched.view.ended
    assert watched.lines == ["item 2: waypoint", "item 3: script message (1, 40)", "item 4: land"]


def test_an_item_that_runs_again_is_shown_again() -> None:
    watched = Watched()
    for _ in range(2):
        watched.text("Mission: 2 WP")
        watched.current(2)
        watched.text("Mission: 3 Scripting")
        watched.text("Mission: 4 Land")
        watched.current(4)
    assert watched.lines.count("item 3: script message (1, 40)") == 2


def test_items_are_shown_with_the_values_of_the_vine_only() -> None:
    watched = Watched()
    watched.receive("NAMED_VALUE_FLOAT", 191, name="RES_KPA", value=612.3456)
    watched.receive("NAMED_VALUE_FLOAT", 191, name="CYC_LEFT", value=None)
    watched.receive("NAMED_VALUE_FLOAT", 1, name="RES_KPA", value=1.0)
    watched.current(2)
    assert watched.lines == ["item 2: waypoint   RES_KPA 612.3"]


def test_chunks_of_a_text_are_joined() -> None:
    watched = Watched()
    watched.text("V" * 50, 191, id=7, chunk_seq=0)
    watched.text("W" * 50, 191, id=7, chunk_seq=1)
    watched.text("end", 191, id=7, chunk_seq=2)
    watched.text("Vine: vented", 191)
    assert watched.lines == ["V" * 50 + "W" * 50 + "end", "Vine: vented"]


def test_interleaved_chunks_of_several_senders_are_joined_by_sender() -> None:
    watched = Watched()
    watched.text("A" * 50, 1, id=7, chunk_seq=0)
    watched.text("V" * 50, 191, id=7, chunk_seq=0)
    watched.text("O" * 50, 192, id=7, chunk_seq=0)
    watched.text("a", 1, id=7, chunk_seq=1)
    watched.text("o", 192, id=7, chunk_seq=1)
    watched.text("v", 191, id=7, chunk_seq=1)
    assert watched.lines == ["autopilot: " + "A" * 50 + "a", "O" * 50 + "o", "V" * 50 + "v"]


def test_an_unfinished_text_is_dropped_when_its_sender_begins_another() -> None:
    watched = Watched()
    watched.text("V" * 50, 191, id=7, chunk_seq=0)
    watched.text("W" * 50, 191, id=8, chunk_seq=0)
    watched.text("end", 191, id=8, chunk_seq=1)
    assert watched.lines == ["W" * 50 + "end"]


def test_a_mission_completed_before_does_not_end_the_watch() -> None:
    watched = Watched()
    watched.heartbeat(False)
    watched.current(4, state=5)
    watched.current(0, state=2)
    assert not watched.view.ended
    watched.current(1)
    watched.heartbeat(True)
    watched.heartbeat(False)
    assert watched.view.ended


def test_a_mission_without_a_state_is_followed_while_armed() -> None:
    """Older ArduPilot leaves mission_state at 0."""
    watched = Watched()
    watched.heartbeat(False)
    watched.current(0, state=0)
    assert watched.lines == []
    watched.heartbeat(True)
    for seq in (1, 2, 2):
        watched.current(seq, state=0)
    assert [line.split(":")[0] for line in watched.lines] == ["armed", "item 1", "item 2"]
    watched.heartbeat(False)
    assert watched.view.ended


def test_an_item_that_was_not_downloaded() -> None:
    watched = Watched()
    watched.current(9)
    assert watched.lines == ["item 9: not in the downloaded mission"]
