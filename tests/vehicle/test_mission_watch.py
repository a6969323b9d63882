"""Which mission items ran: by ArduPilot's texts, by its progress if texts are lost, and by PX4's commands."""

from __future__ import annotations

import random
import struct
from collections import Counter
from dataclasses import dataclass, field, replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from examples import examples
from flying_vines.config.config import ITEM_COMMANDS
from flying_vines.vehicle.autopilots.ardupilot import (
    ASK_AGAIN_S,
    GIVE_UP_S,
    WAIT_FOR_TEXT_S,
    ArduPilotWatch,
)
from flying_vines.vehicle.autopilots.px4 import Px4Watch
from flying_vines.vehicle.clock import BACKLOG_S, LATE_S, AutopilotClock
from flying_vines.vehicle.mavlink.codec import MavlinkCodec, MavlinkMessage
from flying_vines.vehicle.mission.item import Execution, MissionItem
from flying_vines.vehicle.mission.mission_cache import MAX_ITEMS, MissionCache

WP, TAKEOFF, LAND, DELAY, SCRIPT, GRIPPER, WINCH = 16, 22, 21, 93, 217, 211, 42600
CONDITION_DELAY, JUMP, SERVO, SPEED = 112, 177, 183, 178
NAMES = {
    WP: "WP", TAKEOFF: "Takeoff", LAND: "Land", DELAY: "Delay", SCRIPT: "Scripting", GRIPPER: "Gripper",
    WINCH: "Winch", SERVO: "SetServo", SPEED: "ChangeSpeed", CONDITION_DELAY: "CondDelay", JUMP: "Jump",
}  # fmt: skip
NAV = {WP, TAKEOFF, LAND, DELAY}
PAYLOAD = {SCRIPT, GRIPPER, WINCH}
TICK_S = 0.02


def mission(*commands: int) -> list[MissionItem]:
    return [
        MissionItem(seq, command, (float(seq), 40.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        for seq, command in enumerate(commands)
    ]


PLAN = mission(WP, TAKEOFF, WP, SCRIPT, GRIPPER, WP, SCRIPT, WP, LAND)
"""Home, take-off, and two legs that end in payload items: 3 and 4 after waypoint 2, 6 after waypoint 5."""


def item_message(one: MissionItem) -> MavlinkMessage:
    p1, p2, p3, p4, _, _, z = one.params
    return mavlink.MAVLink_mission_item_int_message(
        1, 191, one.seq, one.frame, one.command, 0, 1, p1, p2, p3, p4, 0, 0, z, 0
    )


def identified(total: int, mission_id: int) -> MavlinkMessage:
    """MISSION_CURRENT of a newer autopilot, with fields that the dialect does not name."""
    payload = struct.pack("<HHBBIII", 2, total, 0, 0, mission_id, 0, 0)
    message = mavlink.MAVLink_mission_current_message(2, total)
    message.pack = lambda mav, **_: _frame(payload, mav.seq)
    return message


def _frame(payload: bytes, sequence: int) -> bytes:
    header = bytes((len(payload), 0, 0, sequence, 1, 1, 42, 0, 0))
    checksum = mavlink.x25crc(header + payload + bytes((28,))).crc
    return b"\xfd" + header + payload + struct.pack("<H", checksum)


class Air:
    """An ArduPilot's frames, some of them lost."""

    def __init__(self, items: list[MissionItem], given_beforehand: bool = True) -> None:
        self.cache = MissionCache(items) if given_beforehand else MissionCache()
        self.clock = AutopilotClock()
        self.watch = ArduPilotWatch(self.cache, PAYLOAD, self.clock)
        self.asked: list[int] = []
        self.stored: dict[int, MissionItem] = {}
        """The mission that the autopilot sends."""
        self.t = 100.0
        self.found: list[Execution] = []
        self._mav = mavlink.MAVLink(None, 1, 1)
        self._awake_at = self.t - BACKLOG_S
        self.clock.stamp(self._awake_at, int(self._awake_at * 1000))
        self.wait(0.1)

    def send(self, message: MavlinkMessage, lost: bool = False) -> None:
        frame = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        if not lost:
            self._take(frame)
            self._ask()

    def _take(self, frame: bytes) -> None:
        arrived = mavlink.MAVLink(None).parse_char(frame)
        self.clock.frame(self.t, arrived.get_seq())
        self.cache.handle(self.t, arrived)
        self.watch.handle(self.t, arrived)
        self.found += self.watch.due(self.t)

    def _ask(self) -> None:
        for seq in self.watch.asks(self.t):
            self.asked.append(seq)
            if seq in self.stored:
                self.send(item_message(self.stored[seq]))

    def send_twice(self, message: MavlinkMessage, later_s: float) -> None:
        frame = message.pack(self._mav)
        for wait_s in (later_s, 0.0):
            self._take(frame)
            self.wait(wait_s)

    def text(self, words: str, lost: bool = False) -> None:
        self.send(mavlink.MAVLink_statustext_message(6, words.encode(), 0, 0), lost)

    def runs(self, seq: int, name: str | None = None, lost: bool = False) -> None:
        self.text(f"Mission: {seq} {name or NAMES[self.cache.items[seq].command]}", lost)

    def reaches(self, seq: int, lost: bool = False, text_lost: bool = False) -> None:
        self.send(mavlink.MAVLink_mission_item_reached_message(seq), lost)
        self.text(f"Reached command #{seq}", text_lost)

    def current(self, seq: int) -> None:
        self.send(mavlink.MAVLink_mission_current_message(seq, 9))

    def give_mission(self, items: list[MissionItem]) -> None:
        self.send(mavlink.MAVLink_mission_count_message(1, 191, len(items), 0))
        for one in items:
            self.send(item_message(one))

    def stores(self, items: list[MissionItem]) -> None:
        """The autopilot has this mission, and sends any item of it."""
        self.stored = {one.seq: one for one in items}

    def wait(self, for_s: float) -> None:
        for _ in range(round(for_s / TICK_S)):
            self.t += TICK_S
            if self.t - self._awake_at > 1.0:  # other messages come in this time
                self._awake_at = self.t
                self.clock.stamp(self.t, int(self.t * 1000))
                self.clock.frame(self.t, (self._mav.seq - 1) % 256)
            self.found += self.watch.due(self.t)
            self._ask()

    def payloads(self) -> list[int | None]:
        return [execution.seq for execution in self.found if execution.command in PAYLOAD]

    def tell(self, story: str) -> None:
        """`at 2`: the current item. `gap`: a lost frame. `runs 3 lost`: its text does not arrive."""
        for step in story.split(", "):
            match step.split():
                case ["at", seq]:
                    self.current(int(seq))
                case ["reached", seq, *lost]:
                    self.reaches(int(seq), lost == ["lost"], lost == ["lost"])
                case ["runs", seq, *lost]:
                    self.runs(int(seq), lost=lost == ["lost"])
                case ["gap"]:
                    self.text("another", lost=True)
                case [seconds, "s"]:
                    self.wait(float(seconds))
                case _:
                    raise ValueError(step)


def having_read(items: list[MissionItem]) -> Air:
    """The mission was read from the autopilot."""
    air = Air([], given_beforehand=False)
    air.give_mission(items)
    return air


def certain(execution: Execution | None) -> Execution:
    assert execution is not None
    return execution


def test_each_text_is_one_execution_with_its_numbers() -> None:
    air = Air(PLAN)
    air.current(2)
    air.wait(1.0)
    air.reaches(2)
    air.runs(3)
    (found,) = [execution for execution in air.found if execution.command in PAYLOAD]
    assert (found.seq, found.command, found.params, found.item) == (3, SCRIPT, PLAN[3].params, PLAN[3])
    # The second item's text comes after the next waypoint's.
    air.runs(5)
    air.wait(0.006)
    air.runs(4)
    air.current(5)
    air.wait(30.0)
    assert air.payloads() == [3, 4]


@pytest.mark.parametrize(
    "words", ["Mission: 3", "mission: 3 Scripting", "Mission: x Scripting", "A Mission: 3 S"]
)
def test_other_texts_are_no_items(words: str) -> None:
    air = Air(PLAN)
    air.text(words)
    air.wait(5.0)
    assert air.found == []


@pytest.mark.parametrize("words", ["Mission: 3 Scripting fn=1", "Mission: 3 Scripting"])
def test_more_words_behind_the_name_are_allowed(words: str) -> None:
    air = Air(PLAN)
    air.text(words)
    assert air.payloads() == [3]


@pytest.mark.parametrize(("reached_lost", "text_lost"), [(False, False), (True, False), (False, True)])
def test_the_item_of_a_lost_text_is_added_once(reached_lost: bool, text_lost: bool) -> None:
    air = Air(PLAN)
    air.current(2)
    air.wait(5.0)
    air.reaches(2, reached_lost, text_lost)
    air.tell("runs 3 lost, runs 5, runs 4 lost, at 5")
    assert air.payloads() == []
    air.tell(TOO_LATE)
    assert air.payloads() == [3, 4]
    assert air.found[-1].params == PLAN[4].params
    for _ in range(50):
        air.current(5)
        air.wait(0.2)
    assert air.payloads() == [3, 4]


LOOP = mission(WP, TAKEOFF, WP, WP, SCRIPT, JUMP, GRIPPER, WP, LAND)
LOOP[5] = MissionItem(5, JUMP, (2.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
BEFORE_A_SPEED = mission(WP, TAKEOFF, WP, SCRIPT, SPEED, WP, LAND)
PASS, LOST_PASS = (f"at 2, 20 s, reached 2, runs 3{lost}, runs 4{lost}, at 5, 20 s" for lost in ("", " lost"))
TOO_LATE = f"{WAIT_FOR_TEXT_S + 0.1} s"


@pytest.mark.parametrize(
    ("items", "story", "ran"),
    [
        # DO_JUMP, or a pilot's choice of the item: an item that runs again is reported again.
        (PLAN, "runs 3, 5 s, runs 3, 5 s, runs 3, 5 s, runs 3, runs 3", [3] * 5),
        # After a jump and back, an item is not added again.
        (
            PLAN,
            "at 2, reached 2, runs 3, runs 4 lost, at 5, "
            f"{TOO_LATE}, runs 2, at 2, 0.5 s, runs 5, at 5, 0.5 s, 10 s",
            [3, 4],
        ),
        # Of two items only the lost one is added.
        (PLAN, "at 2, reached 2, runs 3, runs 4 lost, 0.2 s, at 5, 10 s", [3, 4]),
        # An item is not added if its text only comes late.
        (PLAN, "at 2, reached 2, gap, at 5, 0.9 s, runs 3, runs 4, 10 s", [3, 4]),
        # Without a lost frame, an item without text did not run.
        (PLAN, "at 2, reached 2, at 5, 10 s", []),
        # The items that a jump skips did not run.
        (PLAN, "at 2, 5 s, gap, runs 7, at 7, 10 s", []),
        (PLAN, "at 2, 5 s, reached 2, runs 3, runs 4, 0.1 s, runs 7 lost, at 7, 10 s", [3, 4]),
        # A gap long after the end of a waypoint adds none of its items.
        (PLAN, "at 2, reached 2, 3.5 s, gap, at 5, 10 s", []),
        # An item that is found after a later vine item is too old; other items do not matter.
        (PLAN, "at 2, reached 2, runs 3 lost, runs 4, at 5, 10 s", [4]),
        (BEFORE_A_SPEED, "at 2, reached 2, runs 3 lost, runs 4, at 5, 10 s", [3]),
        # An item of the second pass of a loop is also added.
        (PLAN, ", ".join((PASS, LOST_PASS, LOST_PASS, PASS)), [3, 4] * 4),
        # A loop is left and entered after the items before its jump.
        (
            LOOP,
            "at 3, 10 s, reached 3, runs 4 lost, at 2, 10 s, at 3, 10 s, reached 3, runs 4 lost, at 7, 10 s",
            [4, 4],
        ),
        # If a waypoint was left at once, only its first item is certain.
        (PLAN, "at 2, reached 2, runs 3 lost, runs 4 lost, at 5, 0.2 s, at 7, 10 s", [3]),
        # A repeated end of a waypoint changes nothing.
        (PLAN, "at 2, reached 2, runs 3, runs 4, 0.8 s, reached 2, gap, at 5, 10 s", [3, 4]),
    ],
)
def test_which_items_ran_by_texts_and_by_progress(
    items: list[MissionItem], story: str, ran: list[int]
) -> None:
    air = Air(items)
    air.tell(story)
    assert air.payloads() == ran


@pytest.mark.parametrize("conditional", [112, 113, 114, 115, 177, 601])
def test_items_behind_a_condition_are_never_guessed(conditional: int) -> None:
    air = Air(mission(WP, TAKEOFF, WP, SCRIPT, conditional, GRIPPER, WP, LAND))
    air.tell("at 2, reached 2, gap, at 6, 10 s")
    assert air.payloads() == [3]


def test_a_mission_that_was_left_at_the_waypoint_ran_only_the_first_item_for_certain() -> None:
    air = Air(PLAN)
    air.tell("at 2, reached 2, runs 3 lost, runs 4 lost, at 5, 0.2 s")
    air.send(mavlink.MAVLink_mission_current_message(5, 8, 2, 0))
    air.wait(10.0)
    assert air.payloads() == [3]


def test_an_item_that_reports_its_end_needs_no_text() -> None:
    air = Air(mission(WP, TAKEOFF, WP, WINCH, WP, LAND))
    air.tell("at 2, reached 2 lost, runs 3 lost")
    air.reaches(3, text_lost=True)
    air.tell("at 4, 10 s")
    assert air.payloads() == [3]
    air.tell("runs 3, reached 3, gap, 10 s")  # and with its text it is still one
    assert air.payloads() == [3, 3]


def test_a_copy_of_a_frame_that_comes_late_is_no_second_execution() -> None:
    air = Air(PLAN)
    air.send_twice(mavlink.MAVLink_statustext_message(6, b"Mission: 3 Scripting"), 1.0)
    assert air.payloads() == [3]


def handed_over(air: Air, params: tuple[float, ...]) -> Execution | None:
    return air.watch.command(air.t, ITEM_COMMANDS["user_1"], params, 0)


def test_an_item_from_the_script_is_not_added_again() -> None:
    air = Air(PLAN)
    air.tell("at 2, reached 2, runs 3 lost")
    air.found.append(certain(handed_over(air, PLAN[3].params)))
    air.tell("runs 4, at 5, 10 s")
    assert air.payloads() == [3, 4]


def test_an_item_that_the_script_repeats_is_still_the_same_item() -> None:
    air = Air(PLAN)
    air.runs(3)
    air.wait(2.0)
    assert handed_over(air, PLAN[3].params) is None
    air.found.append(certain(handed_over(air, PLAN[3].params)))
    air.wait(2.0)
    air.runs(3)
    assert air.payloads() == [3, 3]


def test_nothing_overtakes_an_item_that_waits_for_its_numbers() -> None:
    air = having_read(PLAN)
    air.runs(3)
    air.runs(4)
    air.send(item_message(PLAN[4]))
    air.wait(0.4)
    assert air.found == []
    air.send(item_message(PLAN[3]))
    assert air.payloads() == [3, 4]


def test_a_text_of_an_item_beyond_the_stored_mission_starts_a_new_reading() -> None:
    air = having_read(PLAN[:3])
    air.runs(3, "Scripting")
    assert not air.cache.fresh
    air.give_mission(PLAN)
    air.wait(0.1)
    assert [(e.seq, e.params) for e in air.found] == [(3, PLAN[3].params)]


def test_a_flood_of_texts_is_not_stored() -> None:
    air = Air([], given_beforehand=False)
    air.send(mavlink.MAVLink_mission_count_message(1, 191, len(PLAN), 0))
    for number in range(8_000):
        air.runs(number, "Scripting")
        handed_over(air, (float(number), 0.0, 0.0, 0.0))
        air.reaches(number)
    sizes = [len(kept) for kept in vars(air.watch).values() if hasattr(kept, "__len__")]
    assert max(sizes) <= MAX_ITEMS + 1


def test_a_mission_cache_that_changes_meanwhile_is_not_used_for_a_guess() -> None:
    air = having_read(PLAN)
    air.tell("at 2, reached 2, runs 3 lost, at 5")
    air.text("Flight plan received")
    air.give_mission(mission(WP, TAKEOFF, WP, WINCH, WINCH, WP, WINCH, WP, LAND))
    air.wait(10.0)
    assert air.payloads() == []


def test_an_item_needs_no_stored_mission() -> None:
    air = Air([], given_beforehand=False)
    air.stores(PLAN)
    air.runs(3, "Scripting")
    assert [(e.seq, e.params, e.age_s) for e in air.found] == [(3, PLAN[3].params, 0.0)]
    air.wait(10.0)
    assert (air.payloads(), air.asked) == ([3], [3])


def test_an_unannounced_mission_of_the_same_length_gives_its_own_numbers() -> None:
    air = having_read(PLAN)
    other = [replace(one, params=(1.0, -11.0, 0.0, 0.0, 0.0, 0.0, 0.0)) for one in PLAN]
    air.stores(other)
    air.runs(3)
    air.runs(4)
    assert [(e.seq, e.params, e.changed) for e in air.found] == [
        (3, other[3].params, True),
        (4, other[4].params, False),  # the stored mission is already marked as outdated
    ]
    assert not air.cache.fresh


def test_an_answer_from_before_an_item_ran_gives_it_no_numbers() -> None:
    air = having_read(PLAN)
    air.send(item_message(PLAN[3]))
    air.runs(3)
    air.wait(GIVE_UP_S - 0.1)
    assert air.found == []
    assert air.asked == [3] * 4


def test_a_request_that_is_lost_is_repeated_soon() -> None:
    air = having_read(PLAN)
    air.runs(3)
    air.wait(ASK_AGAIN_S / 2)
    air.stores(PLAN)
    air.wait(ASK_AGAIN_S)
    assert (air.payloads(), air.asked) == ([3], [3, 3])
    assert air.found[0].age_s == pytest.approx(ASK_AGAIN_S, abs=2 * TICK_S)


def test_an_item_that_the_autopilot_does_not_confirm_has_no_numbers() -> None:
    air = having_read(PLAN)
    air.runs(3)
    air.wait(GIVE_UP_S + 0.1)
    assert [(e.command, e.seq, e.item, e.params) for e in air.found] == [(SCRIPT, 3, None, None)]
    air.send(item_message(PLAN[3]))
    air.wait(5.0)
    assert air.payloads() == [3]


def test_an_answer_of_another_kind_is_not_the_item_that_ran() -> None:
    air = having_read(PLAN)
    air.stores(mission(WP, TAKEOFF, WP, GRIPPER, GRIPPER, WP, WP, WP, LAND))
    air.runs(3, "Scripting")
    air.wait(GIVE_UP_S + 0.1)
    assert [(e.command, e.seq, e.params) for e in air.found] == [(SCRIPT, 3, None)]


def test_a_mission_with_an_id_gives_the_numbers_if_no_answer_comes() -> None:
    air = Air([], given_beforehand=False)
    air.send(identified(9, 77))
    air.give_mission(PLAN)
    air.runs(3)
    air.wait(GIVE_UP_S - 0.1)
    assert air.found == []
    air.wait(0.2)
    assert [(e.seq, e.params) for e in air.found] == [(3, PLAN[3].params)]
    air.send(identified(9, 78))
    air.runs(3)
    air.wait(GIVE_UP_S + 0.1)
    assert air.found[-1].params is None


@pytest.mark.parametrize("replaced", [False, True])
def test_an_added_item_is_also_confirmed(replaced: bool) -> None:
    air = having_read(PLAN)
    other = [replace(one, params=(1.0, -11.0, 0.0, 0.0, 0.0, 0.0, 0.0)) for one in PLAN]
    air.stores(other if replaced else PLAN)
    air.tell("at 2, reached 2, runs 3 lost, runs 4 lost, at 5")
    air.wait(WAIT_FOR_TEXT_S + GIVE_UP_S + 0.1)
    wanted = [None, None] if replaced else [PLAN[3].params, PLAN[4].params]
    assert [(e.seq, e.params) for e in air.found] == list(zip((3, 4), wanted, strict=True))
    if not replaced:
        assert 0.5 <= air.found[0].age_s <= 0.6
        assert air.asked == [3, 4]


def test_a_text_that_comes_after_its_item_was_added_is_no_second_execution() -> None:
    air = Air(PLAN)
    air.tell(f"at 2, reached 2, gap, at 5, {WAIT_FOR_TEXT_S + 0.3} s")
    assert air.payloads() == [3, 4]
    air.tell("runs 3, 5 s, runs 3")
    assert air.payloads() == [3, 4, 3]


def test_without_an_answer_the_kind_is_reported_and_the_numbers_are_not() -> None:
    air = Air([], given_beforehand=False)
    air.runs(3, "Scripting")
    air.runs(7, "SetHome")
    air.wait(GIVE_UP_S + 0.1)
    assert [(e.command, e.seq, e.item, e.params) for e in air.found] == [(SCRIPT, 3, None, None)]


def test_a_name_that_contradicts_the_stored_mission_starts_a_new_reading() -> None:
    air = having_read(PLAN)
    air.runs(3, "Winch")
    assert air.found == []
    assert not air.cache.fresh
    air.wait(0.6)
    assert air.cache.requests(air.t, 1)
    other = mission(WP, TAKEOFF, WP, WINCH, WP, LAND)
    air.give_mission(other)
    air.wait(0.1)
    assert [(e.command, e.seq, e.params) for e in air.found] == [(WINCH, 3, other[3].params)]
    air.wait(10.0)
    assert air.payloads() == [3]


def test_a_waypoints_name_on_a_payload_items_number_runs_no_payload() -> None:
    air = having_read(PLAN)
    air.runs(3, "WP")
    assert not air.cache.fresh
    air.give_mission(mission(WP, TAKEOFF, WP, WP, SCRIPT, LAND))
    air.wait(10.0)
    assert air.payloads() == []


def test_a_name_that_still_contradicts_the_mission_after_one_new_reading_has_no_numbers() -> None:
    air = having_read(PLAN)
    air.runs(3, "Winch")
    air.wait(0.6)
    air.give_mission(PLAN)
    assert air.cache.fresh
    air.wait(5.0)
    assert air.cache.fresh
    assert [(e.command, e.seq, e.params) for e in air.found] == [(WINCH, 3, None)]


def test_an_unknown_name_is_accepted_when_the_autopilot_confirms_it() -> None:
    air = having_read(PLAN)
    air.runs(3, "ScriptMsg")
    assert air.found == []
    air.send(item_message(PLAN[3]))
    assert air.payloads() == [3]


def test_a_given_mission_of_another_flight_gives_no_numbers() -> None:
    air = Air(PLAN)
    air.runs(3, "Winch")
    air.runs(4)
    air.wait(5.0)
    assert [(e.command, e.seq, e.params) for e in air.found] == [
        (WINCH, 3, None),
        (GRIPPER, 4, PLAN[4].params),
    ]


# A whole flight on a bad link, with a model of how ArduPilot runs a mission.


@dataclass
class Flight:
    """The executed items, and the frames that report them."""

    items: list[MissionItem]
    dice: random.Random
    t: float = 0.0
    executed: list[tuple[float, int]] = field(default_factory=list)
    frames: list[tuple[float, bytes]] = field(default_factory=list)
    nav: int = 1
    told_at: float = -1.0

    def __post_init__(self) -> None:
        self.mav = mavlink.MAVLink(None, 1, 1)

    def send(self, message: MavlinkMessage) -> None:
        self.frames.append((self.t, message.pack(self.mav)))
        self.mav.seq = (self.mav.seq + 1) % 256

    def text(self, words: str) -> None:
        self.send(mavlink.MAVLink_statustext_message(6, words.encode(), 0, 0))

    def start(self, seq: int) -> None:
        command = self.items[seq].command
        if command in PAYLOAD:
            self.executed.append((self.t, seq))
        self.text(f"Mission: {seq} {NAMES[command]}")

    def let_pass(self, for_s: float) -> None:
        end = self.t + for_s
        while self.t < end:
            self.t += 0.05
            if self.t - self.told_at >= 0.2:
                self.told_at = self.t
                self.send(mavlink.MAVLink_mission_current_message(self.nav, len(self.items) - 1))
            self.send(mavlink.MAVLink_attitude_message(int(self.t * 1000), 0, 0, 0, 0, 0, 0))

    def next_nav(self, after: int) -> int | None:
        return next((one.seq for one in self.items[after:] if one.command in NAV), None)

    def fly(self) -> None:
        self.start(1)
        for _ in range(14):
            self.let_pass(self.dice.uniform(0.3, 8.0))
            if self.dice.random() < 0.25:
                self.jump(self.dice.randrange(1, len(self.items)))
            elif not self.reach():
                break
        self.let_pass(6.0)

    def jump(self, to: int) -> None:
        nav = self.next_nav(to)
        if nav is None or self.items[to].command in (JUMP, CONDITION_DELAY):
            return
        self.go(to, nav)

    def reach(self) -> bool:
        done, following = self.nav, self.nav + 1
        if self.items[done].command == LAND:
            return False
        self.send(mavlink.MAVLink_mission_item_reached_message(done))
        if self.items[done].command == WP:
            self.text(f"Reached command #{done}")
        while following < len(self.items) and self.items[following].command in PAYLOAD:
            following += 1
        if following < len(self.items) and self.items[following].command == JUMP:
            target = int(self.items[following].params[0])
            for seq in range(done + 1, following):
                self.start(seq)
            self.go(target, target)
            return True
        nav = self.next_nav(done + 1)
        if nav is None:
            return False
        self.go(done + 1, nav)
        return True

    def go(self, first: int, nav: int) -> None:
        """Run the items before the waypoint `nav`, whose own text comes after the first of them."""
        self.nav = nav
        acts = [seq for seq in range(first, nav) if self.items[seq].command != JUMP]
        for seq in acts[:1]:
            self.start(seq)
        self.start(nav)
        for i, seq in enumerate(acts[:1]):
            if self.items[seq].command == CONDITION_DELAY:
                if self.dice.random() < 0.5:  # the next waypoint comes first: waiting items are dropped
                    return
                self.let_pass(1.5)
            assert i == 0
        for seq in acts[1:]:
            if self.items[seq].command == CONDITION_DELAY:
                if self.dice.random() < 0.5:
                    return
                self.let_pass(1.5)
            self.t += 0.006
            self.start(seq)


def plan(dice: random.Random) -> list[MissionItem]:
    commands = [WP, TAKEOFF]
    for _ in range(dice.randrange(2, 6)):
        commands.append(WP)
        commands += dice.choices([SCRIPT, GRIPPER, WINCH], k=dice.choice([0, 1, 1, 2, 3]))
        if dice.random() < 0.2:
            commands += [CONDITION_DELAY, SCRIPT]
        elif dice.random() < 0.2:
            commands.append(JUMP)
    commands += [WP, LAND]
    targets = [seq for seq, command in enumerate(commands) if command == WP and seq > 0]
    return [
        MissionItem(seq, command, (float(dice.choice(targets)) if command == JUMP else seq, 0, 0, 0, 0, 0, 0))
        for seq, command in enumerate(commands)
    ]


def received(flight: Flight, loss: float, copies: float, late_s: float) -> list[tuple[float, MavlinkMessage]]:
    """The flight's messages after a link that loses, copies and delays frames."""
    dice = flight.dice
    arriving: list[tuple[float, int, bytes]] = []
    for t, frame in flight.frames:
        if dice.random() < loss:
            continue
        for _ in range(2 if dice.random() < copies else 1):
            arriving.append((t + dice.uniform(0.0, late_s), len(arriving), frame))
    codec = MavlinkCodec(1, 191)
    return [(t, message) for t, _, frame in sorted(arriving) for message in codec.decode(frame)]


def watched(flight: Flight, messages: list[tuple[float, MavlinkMessage]]) -> list[tuple[float, int]]:
    clock = AutopilotClock()
    watch = ArduPilotWatch(MissionCache(flight.items), PAYLOAD, clock)
    found, now = [], 0.0
    for t, message in [*messages, (flight.t + 10.0, None)]:
        while now < t:
            found += [(now, execution) for execution in watch.due(now)]
            now += TICK_S
        if message is not None:
            clock.frame(t, message.get_seq())
            watch.handle(t, message)
            found += [(t, execution) for execution in watch.due(t)]
    assert all(execution.item is not None for _, execution in found)
    return [(t, e.seq) for t, e in found if e.command in PAYLOAD and e.seq is not None]


@given(
    seed=st.integers(0, 2**32),
    loss=st.sampled_from([0.0, 0.02, 0.2, 0.5]),
    copies=st.sampled_from([0.0, 0.3]),
    late_s=st.sampled_from([0.0, 0.01, 0.1]),
)
@settings(max_examples=examples(70), deadline=None)
def test_no_item_is_found_twice_and_none_that_did_not_run(
    seed: int, loss: float, copies: float, late_s: float
) -> None:
    dice = random.Random(seed)
    flight = Flight(plan(dice), dice)
    flight.fly()
    found = watched(flight, received(flight, loss, copies, late_s))
    open_executions = list(flight.executed)
    for t, seq in found:
        fitting = [one for one in open_executions if one[1] == seq and 0.0 <= t - one[0] <= 5.0]
        assert fitting, f"item {seq} at {t:.2f} did not run then: {flight.executed}"
        open_executions.remove(fitting[0])
    if loss == 0.0:
        assert open_executions == []


def test_at_a_usual_loss_few_items_are_missed() -> None:
    ran, seen = 0, 0
    for seed in range(30):
        dice = random.Random(seed)
        flight = Flight(plan(dice), dice)
        flight.fly()
        ran += len(flight.executed)
        seen += len(watched(flight, received(flight, 0.05, 0.0, 0.0)))
    assert ran > 120
    assert seen / ran > 0.94


# PX4.


def px4(*items: MissionItem, current: int = 0) -> Px4Watch:
    watch = Px4Watch(MissionCache(list(items)))
    watch.handle(0.0, mavlink.MAVLink_mission_current_message(current))
    return watch


def ran(watch: Px4Watch, command: int, params: tuple[float, ...]) -> Execution:
    return certain(watch.command(0.0, command, params, 0))


def actuator(seq: int, value: float) -> MissionItem:
    nan = float("nan")
    return MissionItem(seq, 187, (value, nan, nan, nan, 0.0, 0.0, 0.0), frame=2)


def test_a_command_of_px4_is_the_item_with_its_numbers() -> None:
    nan = float("nan")
    watch = px4(actuator(2, 0.5), actuator(4, -0.1))
    found = ran(watch, 187, (-0.10000000149, nan, nan, nan))  # as a 32-bit float
    assert (found.command, found.seq) == (187, 4)
    assert found.item is not None
    assert found.item.seq == 4


@pytest.mark.parametrize("current", [0, 2, 6, 12])
def test_one_of_several_equal_items_gets_no_number(current: int) -> None:
    """MISSION_CURRENT is stale after a jump: PX4 sent 12 while item 23 ran."""
    nan = float("nan")
    watch = px4(actuator(2, 1.0), actuator(6, 1.0), actuator(11, 0.5), current=current)
    assert ran(watch, 187, (1.0, nan, nan, nan, 0.0, 0.0, 0.0)).seq is None
    assert ran(watch, 187, (0.5, nan, nan, nan, 0.0, 0.0, 0.0)).seq == 11


def test_a_command_that_is_not_in_the_stored_mission_keeps_its_own_numbers() -> None:
    watch = px4(actuator(2, 0.5))
    for command, params in [(187, (0.6, 0.0, 0.0, 0.0)), (211, (0.5, 0.0, 0.0, 0.0))]:
        found = ran(watch, command, params)
        assert (found.command, found.seq, found.item, found.params) == (command, None, None, params)


@pytest.mark.parametrize(("confirmation", "late"), [(0, False), (1, False), (2, True), (3, True)])
def test_the_age_of_the_first_copy_that_arrives(confirmation: int, late: bool) -> None:
    """PX4's repeats are half a second apart, the first one comes after a second."""
    execution = px4(actuator(3, 0.5), current=3).command(10.0, 187, actuator(3, 0.5).params, confirmation)
    assert execution is not None
    assert (execution.age_s > LATE_S) == late


def test_a_repeat_of_an_item_from_before_our_start_is_ignored() -> None:
    watch = px4(actuator(3, 0.5), current=3)
    watch.forget(10.0)
    params = actuator(3, 0.5).params
    # The third frame of a command arrives first: the command was sent more than a second ago.
    assert watch.command(10.3, 187, params, confirmation=2) is None
    # It began after our start only if its first repeat came as early as possible.
    assert watch.command(10.9, 187, params, confirmation=2) is None
    assert watch.command(12.2, 187, params, confirmation=2) is not None


def test_a_repeat_of_an_item_is_ignored_after_a_later_item_of_its_burst() -> None:
    nan = float("nan")
    items = actuator(2, 0.5), actuator(3, -0.1), MissionItem(4, WP, (0.0,) * 7), actuator(5, 0.9)
    watch = px4(*items)
    assert certain(watch.command(10.0, 187, (-0.1, nan, nan, nan), 0)).seq == 3
    assert watch.command(11.0, 187, (0.5, nan, nan, nan), 1) is None
    assert certain(watch.command(12.0, 187, (0.9, nan, nan, nan), 1)).seq == 5
    assert certain(watch.command(12.5, 187, (0.5, nan, nan, nan), 1)).seq == 2  # a waypoint is between them
    assert watch.command(12.8, 187, (0.9, nan, nan, nan), 1) is None  # it began before the last one
    assert certain(watch.command(12.9, 187, (0.9, nan, nan, nan), 0)).seq == 5


def test_the_model_flight_really_runs_what_it_should() -> None:
    counts: Counter[int] = Counter()
    for seed in range(40):
        dice = random.Random(seed)
        flight = Flight(plan(dice), dice)
        flight.fly()
        counts.update(Counter(seq for _, seq in flight.executed).values())
    assert counts[1] > 100
    assert counts[2] > 10  # loops and jumps run items again


# PX4, with lost commands of items.


class Px4Air:
    """A PX4's messages. Some of its commands do not arrive."""

    def __init__(self, *items: MissionItem, mission_id: int = 77) -> None:
        self.clock, self.cache = AutopilotClock(), MissionCache()
        self.watch = Px4Watch(self.cache, {187, GRIPPER, WINCH}, self.clock)
        self.t, self.sequence = 100.0, 0
        self.found: list[Execution] = []
        self._mav = mavlink.MAVLink(None, 1, 1)
        self.send(identified(len(items), mission_id))
        self.send(mavlink.MAVLink_mission_count_message(1, 191, len(items), 0))
        for one in items:
            self.send(item_message(one))
        self.wait(5.0)

    def send(self, message: MavlinkMessage) -> None:
        arrived = mavlink.MAVLink(None).parse_char(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        self.clock.frame(self.t, arrived.get_seq())
        self.cache.handle(self.t, arrived)
        self.watch.handle(self.t, arrived)

    def lose_frames(self) -> None:
        self._mav.seq = (self._mav.seq + 3) % 256

    def reaches(self, seq: int, for_s: float = 0.0) -> None:
        """Reach an item, and let this time pass."""
        self.send(mavlink.MAVLink_mission_item_reached_message(seq))
        self.wait(for_s)

    def command(self, item: MissionItem, confirmation: int = 0) -> None:
        execution = self.watch.command(self.t, item.command, item.params, confirmation)
        self.found += [execution] if execution is not None else []

    def wait(self, for_s: float) -> None:
        for _ in range(round(for_s / TICK_S)):
            self.t += TICK_S
            self.found += self.watch.due(self.t)

    def seqs(self) -> list[int | None]:
        return [execution.seq for execution in self.found]


BENT, STRAIGHT = actuator(2, 0.5), actuator(4, 0.0)
PX4_PLAN = (
    MissionItem(0, TAKEOFF, (0.0,) * 7),
    MissionItem(1, WP, (0.0,) * 7),
    BENT,
    MissionItem(3, WP, (0.0,) * 7),
    STRAIGHT,
    MissionItem(5, WP, (0.0,) * 7),
    MissionItem(6, WINCH, (1.0, 1.0, 2.0, 0.5, 0.0, 0.0, 0.0), frame=2),
    MissionItem(7, WP, (0.0,) * 7),
)


def test_a_straightening_whose_command_was_lost_is_added_once() -> None:
    air = Px4Air(*PX4_PLAN)
    air.reaches(1)
    air.command(BENT)
    air.reaches(2)
    for _ in range(9):
        air.wait(1.0)
        air.reaches(2)
    air.lose_frames()
    air.reaches(4)
    assert air.seqs() == [2]
    air.wait(0.4)
    assert air.seqs() == [2, 4]
    assert air.found[1].item == air.cache.items[4]
    for confirmation in (1, 2, 3):  # its repeats are the same item
        air.wait(0.5)
        air.command(STRAIGHT, confirmation)
        air.reaches(4)
    assert air.seqs() == [2, 4]


@pytest.mark.parametrize("reached_first", [False, True])
def test_an_item_whose_command_came_is_not_carried_out_again(reached_first: bool) -> None:
    air = Px4Air(*PX4_PLAN)
    for item in (BENT, STRAIGHT):
        if reached_first:
            air.reaches(item.seq, 0.02)
        air.command(item)
        for _ in range(10):
            air.reaches(item.seq, 1.0)
    assert air.seqs() == [2, 4]


def test_a_winch_is_reported_as_reached_long_after_its_command() -> None:
    air = Px4Air(*PX4_PLAN)
    air.command(PX4_PLAN[6])
    air.reaches(5, 20.0)
    air.reaches(6, 5.0)
    assert air.seqs() == [6]


def test_a_second_pass_whose_command_was_lost_counts() -> None:
    air = Px4Air(*PX4_PLAN)
    for received in (True, False):
        air.reaches(3)
        if received:
            air.command(STRAIGHT)
        air.reaches(4, 5.0)
        air.reaches(5, 5.0)
    assert air.seqs() == [4, 4]


def test_an_item_before_a_later_one_is_not_added() -> None:
    nan = float("nan")
    burst = MissionItem(3, GRIPPER, (1.0, 1.0, nan, nan, 0.0, 0.0, 0.0), frame=2)
    air = Px4Air(PX4_PLAN[0], PX4_PLAN[1], BENT, burst, MissionItem(4, WP, (0.0,) * 7))
    air.reaches(1)
    air.command(burst)
    air.reaches(2)  # a gripper's command comes before the report of the item before it
    air.wait(0.02)
    air.reaches(3, 5.0)
    assert air.seqs() == [3]


def test_a_waiting_item_is_dropped_after_a_later_one_or_a_person() -> None:
    air = Px4Air(*PX4_PLAN)
    air.reaches(2, 0.1)
    air.command(STRAIGHT)
    air.wait(5.0)
    assert air.seqs() == [4]
    air.reaches(2, 0.1)
    air.watch.forget(air.t)
    air.wait(5.0)
    assert air.seqs() == [4]


def test_items_reached_before_our_start_do_not_count() -> None:
    air = Px4Air(*PX4_PLAN)
    late = Px4Watch(air.cache, {187}, air.clock)
    for _ in range(9):
        late.handle(air.t, mavlink.MAVLink_mission_item_reached_message(2))
        assert late.due(air.t + 0.5) == []
        air.t += 1.0


def test_an_item_reached_before_the_mission_was_read_is_not_reported_by_its_repeat() -> None:
    air = Px4Air(*PX4_PLAN)
    air.send(identified(len(PX4_PLAN), 78))
    air.command(STRAIGHT)
    for _ in range(4):
        air.reaches(4, 1.0)
    air.send(mavlink.MAVLink_mission_count_message(1, 191, len(PX4_PLAN), 0))
    for one in PX4_PLAN:
        air.send(item_message(one))
    assert air.cache.fresh
    air.reaches(5)
    air.reaches(4, 4.0)
    assert len(air.found) == 1


def test_a_mission_that_may_be_another_one_gives_no_numbers() -> None:
    air = Px4Air(*PX4_PLAN, mission_id=0)
    air.reaches(4, 4.0)
    assert [(e.seq, e.params) for e in air.found] == [(4, None)]
    air = Px4Air(*PX4_PLAN)
    air.send(identified(len(PX4_PLAN), 78))
    air.reaches(4, 4.0)
    assert air.found == []  # and item 4 is unknown


def test_the_possible_delay_of_a_reached_item_is_given_if_frames_were_lost() -> None:
    air = Px4Air(*PX4_PLAN)
    air.reaches(1, 1.0)
    air.reaches(1)
    air.lose_frames()
    air.wait(3.0)
    air.reaches(2, 1.0)
    assert air.seqs() == [2]
    assert air.found[0].age_s == pytest.approx(3.3, abs=0.05)


def test_the_number_of_a_repeated_item_is_reported_where_it_was_reached_first() -> None:
    again = actuator(6, 0.5)
    air = Px4Air(*PX4_PLAN[:6], again, PX4_PLAN[7])
    air.command(BENT)
    air.wait(5.0)
    air.reaches(6, 0.01)
    air.command(again)
    assert air.seqs() == [None, 6]
