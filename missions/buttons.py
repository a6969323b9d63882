"""Makes QGroundControl's buttons for the vine (custom actions) from a configuration.

QGroundControl shows the actions of one file in the Fly View and for joystick buttons. It sends them at once,
without confirmation. Its joystick list also contains the flight modes, and of two entries with one name it
uses the first. PX4 has a mode "Hold". So all labels here begin with "Vine".
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config.config import Config, param_index
from flying_vines.vehicle.triggers import BEND_TO, CHOICES, Rules
from flying_vines.vine.intent import (
    ArmPneumatics,
    ClearLatchedFaults,
    DisarmPneumatics,
    Hold,
    Intent,
    StartProfile,
    VentVine,
)

ANGLES = 4
"""Number of angle steps over the bend curve; few, so that a button is found quickly."""

USER_1 = mavlink.MAV_CMD_USER_1
PARAMS = 7

_WORDS: dict[Intent, tuple[str, str]] = {
    VentVine(): ("Vine vent", "Vent the vine"),
    Hold(): ("Vine hold", "Keep the vine as it is"),
    ClearLatchedFaults(): ("Vine clear faults", "Clear faults whose cause is gone"),
    DisarmPneumatics(): ("Vine disarm pneumatics", "Vent the vine and refuse all bends"),
    ArmPneumatics(): ("Vine arm pneumatics", "Allow the vine to bend"),
}


class Button(NamedTuple):
    """A button, and the command that it sends to our component."""

    label: str
    description: str
    command: int
    params: tuple[float, ...]


def buttons(config: Config) -> list[Button]:
    """Vent first, buttons for the ground last."""
    first = (VentVine(), Hold())
    rest = [intent for intent in _WORDS if intent not in first]
    return [
        *(_choice(intent) for intent in first),
        *_profiles(config),
        *_angles(config),
        *(_choice(intent) for intent in rest),
    ]


def actions_text(config: Config) -> str:
    """The buttons as QGroundControl reads them (fileType MavlinkActions, version 1)."""
    actions = [
        {
            "label": button.label,
            "description": button.description,
            "mavCmd": button.command,
            "compId": config.vehicle.component_id,
            **{f"param{n}": _plain(value) for n, value in enumerate(button.params, 1) if n == 1 or value},
        }
        for button in buttons(config)
    ]
    whole = {"version": 1, "fileType": "MavlinkActions", "actions": actions}
    return json.dumps(whole, indent=4, ensure_ascii=False, allow_nan=False) + "\n"


def write_buttons(config: Config, path: Path) -> None:
    """Write the file for QGroundControl's folder MavlinkActions."""
    path.write_text(actions_text(config), encoding="utf-8")


def _choice(intent: Intent) -> Button:
    for command, choices in CHOICES.items():
        for number, (_, offered) in enumerate(choices):
            if offered == intent:
                return Button(*_WORDS[intent], command, (number,))
    raise LookupError(f"no command means: {intent}")


def _profiles(config: Config) -> Iterator[Button]:
    """A button for each profile that a rule for USER_1 starts.

    A rule gives no button if an earlier rule matches the same params.
    """
    rules = Rules(config)
    offered = set()
    for item in config.items:
        if item.profile is None or item.profile in offered or USER_1 not in item.command_ids:
            continue
        params = [0.0] * PARAMS
        for name, value in item.match.items():
            params[param_index(name)] = value
        if rules.for_command(USER_1, params)[0] == StartProfile(item.profile):
            offered.add(item.profile)
            label = f"Vine {item.profile}"
            if label in dict(_WORDS.values()):
                label += " profile"
            yield Button(label, f"Start the profile {item.profile}", USER_1, tuple(params))


def _angles(config: Config) -> Iterator[Button]:
    """Even steps over the bend curve, in whole degrees."""
    curve = config.vine.bend_curve()
    step = (curve.max_deg - curve.min_deg) / ANGLES
    for angle in dict.fromkeys(int(curve.min_deg + step * n) for n in range(ANGLES + 1)):
        if angle:
            yield Button(f"Vine {angle}°", f"Bend to {angle} degrees and stay", BEND_TO, (angle,))


def _plain(number: float) -> float:
    """An integer if the value is whole."""
    return int(number) if float(number).is_integer() else number
