"""Finds the mission item for an intent: the reverse of the configuration's `[[items]]` rules.

An item is used only if the autopilot accepts it, and if its stored numbers still mean the same intent.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from flying_vines.config.config import ITEM_COMMANDS, Config, ItemConfig, param_index
from flying_vines.vehicle.autopilots import AUTOPILOTS
from flying_vines.vehicle.mission.item import (
    MISSION_FRAME,
    AutopilotKind,
    MissionItem,
    MissionRefused,
    Params,
    f32,
    has_place,
    is_nav,
)
from flying_vines.vehicle.triggers import NAME_OF_COMMAND, Rules
from flying_vines.vine.intent import BendTo, Intent, StartProfile

ANGLE_TOLERANCE_DEG = 0.01
"""Largest rounding error of an angle: an item stores the angle, divided by the rule's `scale`, as a 32-bit
float."""


def item_for_intent(intent: Intent, config: Config, kind: AutopilotKind) -> MissionItem | None:
    """An item (with seq 0) that means `intent` on this autopilot, or None."""
    rules = Rules(config)
    for command, rule in _by_preference(config, kind):
        item = MissionItem(0, command, _numbers(rule, intent), MISSION_FRAME)
        if _same(rules.for_command(command, item.params)[0], intent) and survives(item, intent, rules, kind):
            return item
    return None


def survives(item: MissionItem, intent: Intent, rules: Rules, kind: AutopilotKind) -> bool:
    """True if the item still means `intent` after the transfer and the autopilot's storage."""
    try:
        stored = AUTOPILOTS[kind].store(over_the_wire(item))
    except MissionRefused:
        return False
    return _same(rules.for_command(stored.command, stored.params)[0], intent)


def over_the_wire(item: MissionItem) -> MissionItem:
    """The item after a transfer as MISSION_ITEM_INT: 32-bit floats, x and y as integers."""
    p1, p2, p3, p4, x, y, z = item.params
    scale = 1e7 if has_place(item.command, item.frame) else 1.0
    x, y = (round(value * scale) / scale if math.isfinite(value) else value for value in (x, y))
    return replace(item, params=(f32(p1), f32(p2), f32(p3), f32(p4), x, y, f32(z)))


def suggestion(intent: Intent, config: Config, kind: AutopilotKind) -> str:
    """One line with the `[[items]]` entry that would add an item for `intent`."""
    autopilot = AUTOPILOTS[kind]
    name = autopilot.item_commands[0]
    used = {rule.match.get("param1") for rule in config.items if ITEM_COMMANDS[name] in rule.command_ids}
    number = next(n for n in range(1000) if n not in used)
    does = f'profile = "{intent.name}"' if isinstance(intent, StartProfile) else 'bend = "param2"'
    return f'[[items]] command = "{name}" match = {{ param1 = {number}{autopilot.item_match} }} {does}'


def described(item: MissionItem) -> str:
    """An item as text: the command's name and its params, without trailing zeros."""
    name = NAME_OF_COMMAND.get(item.command, f"MAV_CMD {item.command}").replace("_", " ")
    numbers = list(item.params)
    while len(numbers) > 1 and numbers[-1] == 0.0:
        numbers.pop()
    return f"{name} ({', '.join(f'{number:g}' for number in numbers)})"


def _by_preference(config: Config, kind: AutopilotKind) -> Iterator[tuple[int, ItemConfig]]:
    """Pairs of command and rule, the best first.

    Of the rules for one command, those with a nonzero param7 come first. For PX4's actuator items, param7 is
    the set of actuators, and a set other than 0 moves no output of the autopilot.
    """
    pairs = [(command, rule) for rule in config.items for command in rule.command_ids if not is_nav(command)]
    ranks = {ITEM_COMMANDS[name]: rank for rank, name in enumerate(AUTOPILOTS[kind].item_commands)}

    def rank(pair: tuple[int, ItemConfig]) -> tuple[int, bool]:
        command, rule = pair
        return ranks.get(command, len(ranks)), not rule.match.get("param7")

    yield from sorted(pairs, key=rank)


def _numbers(rule: ItemConfig, intent: Intent) -> Params:
    numbers = [0.0] * 7
    for key, value in rule.match.items():
        numbers[param_index(key)] = value
    if rule.bend is not None and isinstance(intent, BendTo) and rule.scale:
        numbers[param_index(rule.bend)] = intent.angle_deg / rule.scale
    p1, p2, p3, p4, x, y, z = numbers
    return p1, p2, p3, p4, x, y, z


def _same(found: Intent | None, wanted: Intent) -> bool:
    if isinstance(found, BendTo) and isinstance(wanted, BendTo):
        return abs(found.angle_deg - wanted.angle_deg) <= ANGLE_TOLERANCE_DEG
    return found == wanted
