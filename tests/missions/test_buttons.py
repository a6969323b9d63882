"""QGroundControl accepts the button file, and each button requests what its label says."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from flying_vines.config import config as configuration
from flying_vines.config.config import Config
from flying_vines.vehicle.triggers import CHOICES, Rules, direct_intent
from flying_vines.vine.intent import BendTo, Intent, StartProfile, VentVine
from missions.buttons import actions_text, buttons, write_buttons

NUMBERS = {"mavCmd", "compId", *(f"param{n}" for n in range(1, 8))}
TEXTS = {"label", "description"}


def as_qgroundcontrol_reads(text: str) -> list[dict[str, Any]]:
    """The buttons by QGroundControl's rules (MavlinkActionManager, JsonHelper): three keys are required, all
    have a type, and a command or component that is not a whole number counts as 0 or as missing."""
    file = json.loads(text)
    assert file["fileType"] == "MavlinkActions"
    assert type(file["version"]) is int
    assert file["version"] == 1
    actions: list[dict[str, Any]] = file["actions"]
    assert isinstance(actions, list)
    for action in actions:
        assert {"label", "description", "mavCmd"} <= action.keys() <= NUMBERS | TEXTS
        assert all(type(action[key]) is str and action[key] for key in TEXTS)
        assert all(type(value) in (int, float) for key, value in action.items() if key in NUMBERS)
        assert type(action["mavCmd"]) is int
        assert type(action["compId"]) is int
    return actions


def asked(config: Config, action: dict[str, Any]) -> Intent | None:
    """The intent that our component derives from QGroundControl's command of a button."""
    params = [float(action.get(f"param{n}", 0.0)) for n in range(1, 8)]
    found = direct_intent(action["mavCmd"], params) or Rules(config).for_command(action["mavCmd"], params)
    return found[0]


def changed(*replacements: tuple[str, str]) -> Config:
    text = configuration.default_text()
    for old, new in replacements:
        assert old in text
        text = text.replace(old, new)
    return configuration.parse(text, "test")


def test_the_default_configuration_has_a_button_for_everything_a_person_can_ask() -> None:
    config = configuration.default()
    actions = as_qgroundcontrol_reads(actions_text(config))
    wanted = {action["label"]: asked(config, action) for action in actions}
    assert len(wanted) == len(actions), "QGroundControl tells joystick actions apart by their label"
    assert next(iter(wanted)) == "Vine vent"
    choices = [intent for offered in CHOICES.values() for _, intent in offered if intent is not None]
    profiles = [StartProfile(name) for name in config.profiles]
    angles = [BendTo(15), BendTo(30), BendTo(45), BendTo(60)]
    assert len(wanted) == len(choices) + len(profiles) + len(angles)
    assert set(wanted.values()) == {*choices, *profiles, *angles}
    assert wanted["Vine vent"] == VentVine()
    assert wanted["Vine reach"] == StartProfile("reach")
    assert wanted["Vine 30°"] == BendTo(30)
    assert {action["compId"] for action in actions} == {191}


def test_no_label_is_the_name_of_a_flight_mode_or_of_a_button_of_qgroundcontrol() -> None:
    assert all(button.label.startswith("Vine ") for button in buttons(configuration.default()))


def test_buttons_follow_the_configuration() -> None:
    config = changed(
        ("component_id = 191", "component_id = 25"),
        ("match = { param1 = 3 }", "match = { param1 = 3, param4 = 0.5 }"),
        ("[[0, 0], [2, 0], [20.7, 60]]", "[[0, -30], [20.7, 60]]"),
    )
    actions = as_qgroundcontrol_reads(actions_text(config))
    by_label = {action["label"]: action for action in actions}
    assert {action["compId"] for action in actions} == {25}
    assert (by_label["Vine wave"]["param1"], by_label["Vine wave"]["param4"]) == (3, 0.5)
    assert asked(config, by_label["Vine wave"]) == StartProfile("wave")
    assert [label for label in by_label if label.endswith("°")] == [
        "Vine -30°",
        "Vine -7°",
        "Vine 15°",
        "Vine 37°",
        "Vine 60°",
    ]


def test_a_rule_that_never_applies_gets_no_button() -> None:
    """An earlier rule takes the numbers of the rule for `reach`."""
    config = changed(
        ('match = { param1 = 2 }\nprofile = "reach"', 'match = { param1 = 0 }\nprofile = "reach"')
    )
    labels = [button.label for button in buttons(config)]
    assert "Vine straight" in labels
    assert "Vine reach" not in labels


def test_a_profile_that_is_called_like_another_button_can_be_distinguished_from_it() -> None:
    config = changed(("[profiles.reach]", "[profiles.vent]"), ('profile = "reach"', 'profile = "vent"'))
    wanted = {
        action["label"]: asked(config, action) for action in json.loads(actions_text(config))["actions"]
    }
    assert wanted["Vine vent"] == VentVine()
    assert wanted["Vine vent profile"] == StartProfile("vent")


@pytest.mark.parametrize("degrees", [0.5, 3, 60, 359.9])
def test_every_angle_offered_lies_on_the_curve(degrees: float) -> None:
    config = changed(
        ("[20.7, 60]]", f"[20.7, {degrees}]]"),
        ("to_deg = 60", "to_deg = 0"),
        ("to_deg = 45", "to_deg = 0"),
        ("to_deg = 40", "to_deg = 0.1"),
        ("to_deg = 30", "to_deg = 0"),
    )
    angles = [asked(config, action) for action in as_qgroundcontrol_reads(actions_text(config))]
    bends = [angle.angle_deg for angle in angles if isinstance(angle, BendTo)]
    assert len(bends) == len(set(bends)) <= 4
    assert all(0 < bend <= degrees for bend in bends)


def test_the_file_that_is_shipped_is_the_one_of_the_default_configuration(tmp_path: Path) -> None:
    write_buttons(configuration.default(), tmp_path / "made.json")
    shipped = Path(__file__).parents[2] / "missions/qgroundcontrol/FlyingVines.json"
    assert (tmp_path / "made.json").read_text(encoding="utf-8") == shipped.read_text(encoding="utf-8")
