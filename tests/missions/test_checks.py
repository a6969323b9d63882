"""Each mistake in a mission gives one sentence that names the item and what to do."""

from __future__ import annotations

import math

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mission_building import (
    ACTUATOR,
    DELAY,
    GRIPPER,
    HEAD,
    HOME,
    KINDS,
    LAND,
    RELAY,
    SCRIPT,
    TAKEOFF,
    WINCH,
    WP,
    built,
    finding_texts,
    items,
    reviewed,
    waypoint,
)

from flying_vines.config import config as configuration
from flying_vines.config.config import ItemConfig
from flying_vines.vehicle.mission.item import AutopilotKind, MissionItem

JUMP, CONDITION, LOITER_UNLIMITED = 177, 112, 17
NAN = math.nan


def errors(kind: AutopilotKind, *entries: tuple[float, ...], frame: int = 2) -> list[str]:
    return finding_texts(reviewed(items(*entries, frame=frame), kind))


@pytest.mark.parametrize("kind", KINDS)
def test_a_good_mission_has_no_findings(kind: AutopilotKind) -> None:
    report = reviewed(built(HEAD + waypoint("{ profile = 'reach' }"), kind), kind)
    assert report.findings == []


def test_a_carrier_that_the_autopilot_refuses_comes_with_the_one_it_takes() -> None:
    px4 = errors("px4", (TAKEOFF,), (WP,), (SCRIPT, 1, 40), (WP,), (LAND,))
    assert px4 == [
        "item 2 (script message (1, 40), waypoint 1): PX4 refuses MAV_CMD 217; for 'bend 40°' use "
        "actuator (1, 40, 0, 0, 0, 0, 1)"
    ]
    ardupilot = errors("ardupilot", HOME, (TAKEOFF,), (WP,), (ACTUATOR, 0.5), (WP,), (LAND,))
    assert ardupilot == [
        "item 3 (actuator (0.5), waypoint 1): ArduPilot refuses MAV_CMD 187; for 'bend 30°' use "
        "script message (1, 30)"
    ]


def test_an_item_without_meaning_that_no_autopilot_accepts_must_be_removed() -> None:
    assert errors("px4", (TAKEOFF,), (WP,), (RELAY, 1), (WP,), (LAND,)) == [
        "item 2 (relay (1), waypoint 1): PX4 refuses MAV_CMD 181; remove it"
    ]


def test_a_wrong_frame_is_named() -> None:
    found = errors("px4", (TAKEOFF,), (WP,), (WINCH, 1, 1), (WP,), (LAND,), frame=0)
    assert found == ["item 2 (winch (1, 1), waypoint 1): PX4 refuses it in frame 0; use frame 2"]


def test_not_a_number_is_named() -> None:
    found = errors("ardupilot", HOME, (TAKEOFF,), (WP, 0, NAN), (SCRIPT, 0), (WP,), (LAND,))
    assert found == [
        "item 2 (waypoint, waypoint 1): param2 is not a number, which ArduPilot refuses; write 0"
    ]
    assert errors("px4", (TAKEOFF, 0, 0, 0, NAN), (WP, 0, 0, 0, NAN), (ACTUATOR, 0.5), (WP,), (LAND,)) == []


def test_numbers_that_storage_changes_are_reported_with_what_they_then_mean() -> None:
    config = msgspec.structs.replace(
        configuration.default(),
        items=(
            ItemConfig(command="winch", bend="param1"),
            ItemConfig(command="script_message", bend="param2"),
        ),
    )
    given = items(HOME, (TAKEOFF,), (WP,), (WINCH, 30.5), (WP,), (LAND,))
    assert finding_texts(reviewed(given, "ardupilot", config)) == [
        "item 3 (winch (30.5), waypoint 1): ArduPilot stores other numbers: param1 30.5 becomes 30, so that "
        "'bend 30.5°' becomes 'bend 30°'; use script message (0, 30.5)"
    ]
    on_px4 = items((TAKEOFF,), (WP,), (WINCH, 30.5), (WP,), (LAND,))
    assert finding_texts(reviewed(on_px4, "px4", config)) == []
    harmless = items(HOME, (TAKEOFF,), (WP,), (SCRIPT, 0, 0, 0, 0, 9, 0, 0), (WP,), (LAND,))
    assert "param5 9 becomes 0" in finding_texts(reviewed(harmless, "ardupilot"), "warning")[0]


def test_items_behind_the_end_never_run() -> None:
    after_land = errors("ardupilot", HOME, (TAKEOFF,), (WP,), (SCRIPT, 2), (LAND,), (SCRIPT, 0))
    assert after_land == [
        "item 5 (script message (0)): never runs: no item runs after item 4 (land); move it before that item"
    ]
    trailing = errors("ardupilot", HOME, (TAKEOFF,), (WP,), (SCRIPT, 2), (SCRIPT, 0))
    assert trailing[0].startswith(
        "item 4 (script message (0)): never runs: after the last waypoint ArduPilot runs only one"
    )
    assert errors("ardupilot", HOME, (TAKEOFF,), (WP,), (SCRIPT, 2)) == []
    waits = errors("ardupilot", HOME, (TAKEOFF,), (WP,), (SCRIPT, 2), (DELAY, 6), (SCRIPT, 0), (DELAY, 1))
    assert waits == []


@pytest.mark.parametrize(("kind", "head", "vine"), [("ardupilot", (HOME,), SCRIPT), ("px4", (), ACTUATOR)])
def test_an_item_that_never_runs_comes_with_the_reason(
    kind: AutopilotKind, head: tuple[tuple[float, ...], ...], vine: int
) -> None:
    at = 2 + len(head)
    loiter = errors(kind, *head, (TAKEOFF,), (WP,), (LOITER_UNLIMITED,), (vine, 0), (LAND,), frame=3)
    assert f"no item runs after item {at} (endless loiter); move it before that item" in loiter[-1]
    jump = (JUMP, at + 2, 1)
    skipped = errors(kind, *head, (TAKEOFF,), (WP,), jump, (vine, 0), (WP,), (LAND,))
    assert [text.partition(": ")[2] for text in skipped] == [
        "never runs: a jump skips it; move it, or remove the jump"
    ]


def test_an_item_in_front_runs_on_the_ground() -> None:
    found = errors("ardupilot", HOME, (SCRIPT, 1, 30), (TAKEOFF,), (WP,), (LAND,))
    assert found == [
        "item 1 (script message (1, 30)): is the first item, so ArduPilot runs it on the ground, before "
        "arming and again after landing; move it after the take-off"
    ]
    assert "runs it on the ground; move" in errors("px4", (ACTUATOR, 0.5), (TAKEOFF,), (WP,), (LAND,))[0]


def test_home_is_in_front_on_ardupilot_and_nowhere_on_px4() -> None:
    assert errors("ardupilot", (TAKEOFF,), (WP,), (SCRIPT, 2), (LAND,))[0].startswith(
        "item 0 (take-off): ArduPilot uses item 0 as home"
    )
    assert errors("ardupilot", (WP,), (TAKEOFF,), (WP,), (SCRIPT, 2), (LAND,))[0].startswith(
        "item 0 (waypoint): ArduPilot uses item 0 as home"
    ), "an altitude above home cannot be home's own"
    with_home = errors("px4", HOME, (TAKEOFF,), (WP,), (ACTUATOR, 0.5), (LAND,))
    assert any("looks like home" in text for text in with_home)


def test_a_burst_loses_its_first_on_px4() -> None:
    dos = [(178, 1, 5)] * 8
    entries = [(TAKEOFF,), (WP,), (ACTUATOR, 0.5), *dos, (WP,), (LAND,)]
    assert errors("px4", *entries) == [
        "item 2 (actuator (0.5), waypoint 1): one of 9 items in a row without a waypoint; PX4 executes "
        "only the last 8; insert a NAV_DELAY"
    ]
    assert errors("px4", *entries[:3], *dos[1:], (WP,), (LAND,)) == []


def test_two_at_once_and_one_that_is_broken_off() -> None:
    at_once = errors("ardupilot", HOME, (TAKEOFF,), (WP,), (SCRIPT, 1, 30), (SCRIPT, 0), (WP,), (LAND,))
    assert at_once == [
        "item 3 (script message (1, 30), waypoint 1): item 4 follows at once and replaces it; "
        "insert a wait (hold_s)"
    ]
    early = reviewed(
        built(HEAD + waypoint("{ profile = 'reach', hold_s = 3 }, { profile = 'straight' }"), "px4"), "px4"
    )
    assert finding_texts(early) == []
    assert finding_texts(early, "warning") == [
        "item 2 (actuator (2, 0, 0, 0, 0, 0, 1), waypoint 1): takes 5.0 s, but item 4 replaces it after "
        "3.0 s; hold longer"
    ]


def test_too_low_too_long_and_still_bent() -> None:
    low = finding_texts(
        reviewed(built(HEAD + waypoint("{ bend_deg = 30 }", "north_m = 9\naltitude_m = 1"), "px4"), "px4")
    )
    assert "refused: at 1.0 m, below 2 m; fly higher there (interlocks.min_altitude_m)" in low[0]
    long = reviewed(built(HEAD + waypoint("{ bend_deg = 30, hold_s = 200 }"), "px4"), "px4")
    assert (
        "stays bent for 200 s, but safety vents it after 120 s (limits.max_bent_s)" in finding_texts(long)[0]
    )
    assert "still bent when the mission ends" in finding_texts(long, "warning")[0]
    short = reviewed(built(HEAD + waypoint("{ profile = 'reach', hold_s = 200 }"), "px4"), "px4")
    assert short.findings == []


def test_a_refused_item_does_not_end_the_bend_before_it() -> None:
    def found(hold_s: float) -> list[str]:
        bend, outside, straight, wait = (SCRIPT, 1, 30), (SCRIPT, 1, 90), (SCRIPT, 0), (DELAY, hold_s)
        given = items(HOME, (TAKEOFF,), (WP,), bend, wait, outside, wait, straight, wait, (DELAY, 9), (LAND,))
        return finding_texts(reviewed(given, "ardupilot"))

    long = found(100.0)
    assert len(long) == 2 and "refused: 90° is outside" in long[1]
    assert "item 3 " in long[0] and "stays bent for 200 s, but safety vents it after 120 s" in long[0]
    assert "item 7 follows at once and replaces it" in found(0.05)[0]


def test_an_angle_outside_the_curve() -> None:
    found = errors("ardupilot", HOME, (TAKEOFF,), (WP,), (SCRIPT, 1, 90), (WP,), (LAND,))
    assert "refused: 90° is outside the vine's 0…60°" in found[0]


def test_an_item_without_a_rule_is_only_a_warning() -> None:
    given = items(HOME, (TAKEOFF,), (WP,), (SCRIPT, 77), (WP,), (LAND,))
    report = reviewed(given, "ardupilot")
    assert finding_texts(report) == []
    assert "refused: no rule for script_message (77" in finding_texts(report, "warning")[0]


def test_a_bend_with_too_little_air_is_refused_with_this_reason() -> None:
    given = built(HEAD + waypoint("{ bend_deg = 50 }, { profile = 'straight' }"), "px4")
    report = reviewed(given, "px4", reservoir_kPa=50.0)
    text = finding_texts(report)[0]
    assert "refused: reservoir at 50 kPa, needs " in text and "fill the reservoir more" in text
    waved = built(HEAD + waypoint("{ profile = 'wave' }, { bend_deg = 50 }, { profile = 'straight' }"), "px4")
    doubtful = reviewed(waved, "px4", reservoir_kPa=80.0)
    assert finding_texts(doubtful) == []
    assert any(
        "may be refused, if the reservoir is at its low estimate: reservoir at" in text
        for text in finding_texts(doubtful, "warning")
    )


def test_a_mission_without_the_vine_far_away_with_jumps_and_conditions() -> None:
    far = (WP, 0, 0, 0, 0, 47.5, 8.5455944, 10.0)
    given = items((TAKEOFF,), far, (CONDITION, 3), (JUMP, 1, -1), (WP,), (LAND,))
    warnings = finding_texts(reviewed(given, "px4"), "warning")
    assert any("11.4 km from home" in text for text in warnings)
    assert any("endless loop" in text for text in warnings)
    assert any("may run later than shown" in text for text in warnings)
    assert any("no item matches a rule in [[items]]" in text for text in warnings)


def test_disarmed_pneumatics_are_remembered() -> None:
    default = configuration.default()
    interlocks = msgspec.structs.replace(default.interlocks, armed_at_start=False)
    config = msgspec.structs.replace(default, interlocks=interlocks)
    given = built(HEAD + waypoint("{ profile = 'reach' }"), "px4")
    (text,) = finding_texts(reviewed(given, "px4", config), "warning")
    assert text.endswith("arm them before the flight")


def test_a_place_that_is_none() -> None:
    found = errors("px4", (TAKEOFF,), (WP, 0, 0, 0, 0, 147.5, 8.5, 10.0), (ACTUATOR, 0.5), (LAND,))
    assert "item 1 (waypoint): 147.5, 8.5 is not a place on earth" in found


def test_an_endless_mission_is_cut() -> None:
    found = errors("px4", (TAKEOFF,), (DELAY, 1e9), (WP,), (ACTUATOR, 0.5), (LAND,))
    assert any("more than 6 h" in text for text in found)


def test_jumps_run_the_items_between_again() -> None:
    given = items(
        (TAKEOFF,), (WP,), (ACTUATOR, 0.5), (DELAY, 2), (ACTUATOR, 0), (DELAY, 2), (JUMP, 1, 2), (LAND,)
    )
    report = reviewed(given, "px4")
    assert [bend.step.item.seq for bend in report.budget.bends] == [2, 4] * 3


ANY_NUMBER = st.one_of(
    st.sampled_from((0.0, 1.0, 2.0, 3.0, -1.0, 0.5, NAN, math.inf, -math.inf, 1e30)), st.floats(-5, 5)
)
COMMANDS = st.sampled_from(
    (WP, TAKEOFF, LAND, DELAY, SCRIPT, ACTUATOR, GRIPPER, WINCH, JUMP, CONDITION, 178, 20, 17)
)
ANY_ITEM = st.tuples(COMMANDS, st.tuples(*[ANY_NUMBER] * 7), st.sampled_from((0, 2, 3, 6, 10)))


@settings(max_examples=20)
@given(st.lists(ANY_ITEM, min_size=1, max_size=12), st.sampled_from(KINDS))
def test_any_file_is_checked_without_a_crash(
    entries: list[tuple[int, tuple[float, ...], int]], kind: AutopilotKind
) -> None:
    given = [
        MissionItem(seq, command, (p[0], p[1], p[2], p[3], p[4], p[5], p[6]), frame)
        for seq, (command, p, frame) in enumerate(entries)
    ]
    report = reviewed(given, kind)
    for finding in report.findings:
        assert finding.text.startswith("item ") and "\n" not in finding.text
        assert 0 <= finding.seq < len(given)
