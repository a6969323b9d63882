"""From a mission's text to items: each autopilot's items have the same meaning once stored."""

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
    KINDS,
    LAND,
    SCRIPT,
    TAKEOFF,
    WINCH,
    WP,
    built,
    finding_texts,
    reviewed,
    waypoint,
)

from examples import examples
from flying_vines.config import config as configuration
from flying_vines.config.config import Config, ItemConfig
from flying_vines.vehicle.autopilots import AUTOPILOTS
from flying_vines.vehicle.mission.item import AutopilotKind
from flying_vines.vehicle.triggers import Rules
from flying_vines.vine.intent import BendTo, Intent, StartProfile
from missions.item_for_intent import described, item_for_intent, over_the_wire
from missions.mission import MissionError

DEFAULT = configuration.default()


def with_items(*rules: ItemConfig) -> Config:
    return msgspec.structs.replace(DEFAULT, items=rules)


def test_ardupilot_gets_home_script_messages_and_waits() -> None:
    text = HEAD + waypoint("{ profile = 'reach', hold_s = 6 }, { bend_deg = 30, hold_s = 0 }")
    items = built(text, "ardupilot")
    assert [item.command for item in items] == [WP, TAKEOFF, WP, SCRIPT, DELAY, SCRIPT, LAND]
    assert [item.seq for item in items] == list(range(7))
    assert items[0].frame == 0 and items[0].params[6] == pytest.approx(584.09)
    assert items[3].params[:2] == (2.0, 0.0)
    assert items[4].params[0] == 6.0
    assert items[5].params[:2] == (1.0, 30.0)
    assert items[6].params[4:] == (*items[2].params[4:6], 0.0)


def test_px4_gets_actuators_that_move_no_output_and_no_home() -> None:
    items = built(HEAD + waypoint("{ bend_deg = 30 }"), "px4")
    assert [item.command for item in items] == [TAKEOFF, WP, ACTUATOR, DELAY, LAND]
    assert items[2].frame == 2 and items[2].params == (1.0, 30.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    assert math.isnan(items[1].params[3])


def test_offsets_are_metres_from_home_and_heights_stay() -> None:
    text = HEAD + waypoint("", "north_m = 30\nstay_s = 4\naltitude_m = 15") + waypoint("", "east_m = -20")
    first, second = (item for item in built(text, "px4") if item.command == WP)
    assert first.params[4] - 47.3977431 == pytest.approx(30 / 111_318.84, abs=1e-7)
    assert first.params[0] == 4.0 and first.params[6] == 15.0
    metres = math.cos(math.radians(47.3977431)) * 111_318.84
    assert (second.params[5] - 8.5455944) * metres == pytest.approx(-20, abs=0.01)
    assert second.params[4] == pytest.approx(47.3977431, abs=1e-7) and second.params[6] == 15.0


def test_speed_take_off_actions_and_return() -> None:
    text = 'speed_m_s = 3\nend = "return"\n' + HEAD + "vine = [{ profile = 'straight' }]\n" + waypoint("")
    items = built(text, "ardupilot")
    assert [item.command for item in items] == [WP, TAKEOFF, SCRIPT, DELAY, 178, WP, 20]
    assert items[4].params[:3] == (1.0, 3.0, -1.0)


def test_a_default_hold_lasts_until_the_vine_rests() -> None:
    items = built(HEAD + waypoint("{ profile = 'reach' }, { profile = 'straight' }"), "px4")
    # `reach` takes 1.5 + 2 + 1.5 s; the last `straight` takes no time.
    assert [item.params[0] for item in items if item.command == DELAY] == [5.5, 0.5]


def test_every_wrong_action_is_named_with_its_line() -> None:
    text = HEAD + "vine = [{ profile = 'raech' }]\n" + waypoint("{ bend_deg = 61 }")
    with pytest.raises(MissionError) as error:
        built(text, "px4")
    profile, angle = str(error.value).splitlines()
    assert profile == "m.toml:4: takeoff.vine[0]: there is no profile 'raech'; did you mean 'reach'?"
    assert angle.startswith("m.toml:7: waypoints[0].vine[0]: 61° is outside the vine's 0…60°")


@pytest.mark.parametrize("kind", KINDS)
def test_an_action_without_a_rule_gives_the_rule_to_add(kind: AutopilotKind) -> None:
    config = with_items(ItemConfig(command="gripper", match={"param2": 0.0}, profile="bend-full"))
    with pytest.raises(MissionError) as error:
        built(HEAD + waypoint("{ profile = 'wave' }, { bend_deg = 20 }"), kind, config)
    profile, bend = str(error.value).splitlines()
    for line, intent in ((profile, StartProfile("wave")), (bend, BendTo(20.0))):
        rule = line[line.index("[[items]]") :]
        for word in ("command", "match", "profile =", "bend ="):
            rule = rule.replace(f" {word}", f"\n{word}")
        added = configuration.parse(rule + "\n" + configuration.default_text(), "added").items[0]
        assert item_for_intent(intent, with_items(added), kind) is not None


def test_the_preferred_carrier_is_the_one_that_survives() -> None:
    winch = ItemConfig(command="winch", bend="param1")
    gripper = ItemConfig(command="gripper", bend="param1", scale=0.5)
    # ArduPilot stores both as whole numbers; only the scale of the gripper makes 30.5 possible.
    item = item_for_intent(BendTo(30.5), with_items(winch, gripper), "ardupilot")
    assert item is not None and item.command == GRIPPER and item.params[0] == 61.0
    item = item_for_intent(BendTo(30.0), with_items(gripper, winch), "ardupilot")
    assert item is not None and item.command == WINCH
    assert item_for_intent(BendTo(30.5), with_items(winch), "ardupilot") is None
    whole = item_for_intent(BendTo(30.5), with_items(winch), "px4")
    assert whole is not None and described(whole) == "winch (30.5)"


def test_a_rule_in_front_that_catches_the_numbers_is_seen() -> None:
    catches = ItemConfig(command="script_message", profile="straight")
    behind = ItemConfig(command="script_message", match={"param1": 2.0}, profile="reach")
    assert item_for_intent(StartProfile("reach"), with_items(catches, behind), "ardupilot") is None
    assert item_for_intent(StartProfile("reach"), with_items(behind, catches), "ardupilot") is not None


def test_x_and_y_travel_as_whole_numbers() -> None:
    by_x = ItemConfig(command="winch", bend="param5")
    assert item_for_intent(BendTo(30.5), with_items(by_x), "px4") is None
    assert item_for_intent(BendTo(30.0), with_items(by_x), "px4") is not None


ACTION = st.one_of(
    st.sampled_from(sorted(DEFAULT.profiles)).map(lambda name: (f'profile = "{name}"', StartProfile(name))),
    st.floats(0, 60).map(lambda deg: (f"bend_deg = {deg!r}", BendTo(deg))),
)
HOLD = st.sampled_from(("", ", hold_s = 7", ", hold_s = 9.5"))
PLACE = st.tuples(st.integers(-200, 200), st.integers(-200, 200), st.floats(3, 100))
WAYPOINTS = st.lists(st.tuples(PLACE, st.lists(st.tuples(ACTION, HOLD), max_size=2)), min_size=1, max_size=5)


@settings(max_examples=examples(40))
@given(WAYPOINTS, st.sampled_from(KINDS), st.sampled_from(("land", "return")))
def test_any_mission_passes_its_own_check_and_means_the_same_once_stored(
    places: list[tuple[tuple[int, int, float], list[tuple[tuple[str, Intent], str]]]],
    kind: AutopilotKind,
    end: str,
) -> None:
    text = f'end = "{end}"\n' + HEAD
    wanted: list[Intent] = []
    for (north, east, height), actions in places:
        vine = ", ".join(f"{{ {what}{hold} }}" for (what, _), hold in actions)
        text += waypoint(vine, f"north_m = {north}\neast_m = {east}\naltitude_m = {height!r}")
        wanted += [intent for (_, intent), _ in actions]
    items = built(text, kind)
    report = reviewed(items, kind)
    # Only the time of the bend depends on the mission, because legs may have any length.
    assert [text for text in finding_texts(report) if "max_bent_s" not in text] == []
    rules = Rules(DEFAULT)
    stored = [AUTOPILOTS[kind].store(over_the_wire(item)) for item in items]
    found = [rules.for_command(i.command, i.params)[0] for i in stored if i.command in rules.commands]
    assert len(found) == len(wanted)
    for have, want in zip(found, wanted, strict=True):
        if isinstance(have, BendTo) and isinstance(want, BendTo):
            assert have.angle_deg == pytest.approx(want.angle_deg, abs=0.01)
        else:
            assert have == want
    assert len(report.budget.bends) == len(wanted)
