"""What `mission watch` reports, from messages alone."""

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


class Story:
    """A view, fed message by message."""

    def __init__(self) -> None:
        self.view = MissionView(MISSION)
        self.lines: list[str] = []
        self.t = 0.0

    def hears(self, kind: str, component: int = 1, /, **fields: Any) -> None:
        self.t += 0.1
        self.lines += [
            line.text for line in self.view.handle(self.t, ReceivedMessage(kind, component, fields))
        ]

    def beat(self, armed: bool) -> None:
        self.hears("HEARTBEAT", base_mode=128 if armed else 0)

    def current(self, seq: int, state: int = 3) -> None:
        self.hears("MISSION_CURRENT", seq=seq, mission_state=state)

    def text(self, text: str, component: int = 1, severity: int = 6, **more: int) -> None:
        self.hears("STATUSTEXT", component, text=text, severity=severity, **more)


def test_ardupilot_tells_items_by_text_and_progress_once_each() -> None:
    story = Story()
    story.beat(False)
    story.text("Mission: 1 Takeoff")
    story.current(1)
    story.beat(True)
    story.current(2)
    story.text("Mission: 2 WP")
    story.hears("MISSION_ITEM_REACHED", seq=2)
    story.text("Reached command #2")
    story.text("Mission: 3 Scripting")
    story.text("Mission: 4 Land")
    story.current(4)
    assert not story.view.ended
    story.text("Disarming motors")
    assert story.view.ended
    story.text("Mission: 1 Takeoff")
    assert story.lines == [
        "item 1: take-off",
        "armed",
        "item 2: waypoint",
        "item 2 reached",
        "item 3: script message (1, 40)",
        "item 4: land",
        "autopilot: Disarming motors",
    ]


def test_px4_tells_an_item_that_is_over_at_once_by_reached_alone() -> None:
    story = Story()
    story.current(2)
    for _ in range(3):
        story.hears("MISSION_ITEM_REACHED", seq=3)
    story.current(4)
    story.current(4, state=5)
    assert story.view.ended
    assert story.lines == ["item 2: waypoint", "item 3: script message (1, 40)", "item 4: land"]


def test_an_item_that_runs_again_is_told_again() -> None:
    story = Story()
    for _ in range(2):
        story.text("Mission: 2 WP")
        story.current(2)
        story.text("Mission: 3 Scripting")
        story.text("Mission: 4 Land")
        story.current(4)
    assert story.lines.count("item 3: script message (1, 40)") == 2


def test_values_are_those_of_the_vine_and_stand_beside_the_items() -> None:
    story = Story()
    story.hears("NAMED_VALUE_FLOAT", 191, name="RES_KPA", value=612.3456)
    story.hears("NAMED_VALUE_FLOAT", 191, name="CYC_LEFT", value=None)
    story.hears("NAMED_VALUE_FLOAT", 1, name="RES_KPA", value=1.0)
    story.current(2)
    assert story.lines == ["item 2: waypoint   RES_KPA 612.3"]


def test_texts_of_the_vine_are_put_together() -> None:
    story = Story()
    story.text("V" * 50, 191, id=7, chunk_seq=0)
    story.text("W" * 50, 191, id=7, chunk_seq=1)
    story.text("end", 191, id=7, chunk_seq=2)
    story.text("Vine: vented", 191)
    assert story.lines == ["V" * 50 + "W" * 50 + "end", "Vine: vented"]


def test_a_mission_completed_before_does_not_end_the_watch() -> None:
    story = Story()
    story.beat(False)
    story.current(4, state=5)
    story.current(0, state=2)
    assert not story.view.ended
    story.current(1)
    story.beat(True)
    story.beat(False)
    assert story.view.ended


def test_an_item_that_nobody_knows_is_said_so() -> None:
    story = Story()
    story.current(9)
    assert story.lines == ["item 9: not in the downloaded mission"]
