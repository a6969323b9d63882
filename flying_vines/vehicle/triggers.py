"""Turns triggers (switch, mission items, commands, conditions of packages) into intents, by the tables."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config.config import ITEM_COMMANDS, Config, Param, TriggerConfig, param_index
from flying_vines.config.plugins import PluginError, find
from flying_vines.vehicle.clock import LATE_S
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.mission.item import Execution
from flying_vines.vine.intent import (
    ArmPneumatics,
    BendTo,
    ClearLatchedFaults,
    DisarmPneumatics,
    Hold,
    Intent,
    SetPressure,
    StartProfile,
    StopBench,
    VentVine,
)
from flying_vines.vine.profile import flatten, top_kPa

FLOAT32 = 1e-6
"""Relative error of a 32-bit float, in which MAVLink carries the configuration's numbers."""

NAME_OF_COMMAND = {number: name for name, number in ITEM_COMMANDS.items()}

BEND_TO, SET_PRESSURE = mavlink.MAV_CMD_USER_2, mavlink.MAV_CMD_USER_3
CHOICES: dict[int, tuple[tuple[str, Intent | None], ...]] = {
    mavlink.MAV_CMD_USER_4: (
        ("vent", VentVine()),
        ("hold", Hold()),
        ("disarm", DisarmPneumatics()),
        ("arm", ArmPneumatics()),
    ),
    mavlink.MAV_CMD_USER_5: (
        ("nothing", None),
        ("clear faults", ClearLatchedFaults()),
    ),
}
"""The name and intent of param1 = 0, 1, 2, 3 of each command. We use only commands that no autopilot
implements, because ArduPilot executes commands to us until it has received our heartbeat."""


@dataclass(frozen=True, slots=True)
class Trigger:
    """A request to move the vine: its source and its intent.

    `problem` is the reason to refuse the request, if there is one already. `intent` is None if the request
    has no meaning for the vine.
    """

    t: float
    kind: str
    what: dict[str, object]
    intent: Intent | None
    problem: str = ""
    by_person: bool = False
    command: MavlinkMessage | None = None
    """The command that waits for an acknowledgement."""
    age_s: float = 0.0
    """The minimum age of the request."""
    seen_at: float = math.inf
    """Time of the state that the person saw. Faults that latched later are not cleared."""

    def __str__(self) -> str:
        return self.kind + " " + " ".join(f"{key}={value}" for key, value in self.what.items())


def only_deflates(config: Config, intent: Intent | None) -> bool:
    """True if the intent deflates the vine from any present pressure. That is always safe."""
    curve = config.vine.bend_curve()
    match intent:
        case VentVine() | DisarmPneumatics() | StopBench():
            return True
        case StartProfile(name) if name in config.profiles:
            return top_kPa(tuple(flatten(config.profiles, name)), curve, math.inf) <= 0.0
        case BendTo(angle_deg) if curve.min_deg <= angle_deg <= curve.max_deg:
            return curve.pressure_kPa(angle_deg) <= 0.0
        case SetPressure(target_kPa):
            return target_kPa <= 0.0
    return False


class Rules:
    """Finds the intent of a switch position, a mission item or a command in `[switch]` and `[[items]]`."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._items = config.items
        self._positions = config.switch.positions
        self.commands = {command for item in config.items for command in item.command_ids}
        self._bends = [
            bool(name) and not only_deflates(config, StartProfile(name)) for name in self._positions
        ]

    def only_deflates(self, intent: Intent | None) -> bool:
        return only_deflates(self._config, intent)

    def for_position(self, position: int) -> Intent | None:
        """The intent of a switch position; None if its name in the configuration is empty."""
        name = self._positions[position]
        return StartProfile(name) if name else None

    def bends(self, position: int) -> bool:
        """True if the profile of a switch position inflates the vine."""
        return self._bends[position]

    def for_command(self, command: int, params: Sequence[float] | None) -> tuple[Intent | None, str]:
        """The intent of a mission item or command, or None and the reason."""
        name = NAME_OF_COMMAND.get(command, str(command))
        if params is None:
            return None, "params not confirmed"
        for item in self._items:
            if command not in item.command_ids or not _matches(item.match, params):
                continue
            if item.profile is not None:
                return StartProfile(item.profile), ""
            angle_deg = _param(params, item.bend or "param1") * item.scale
            if not math.isfinite(angle_deg):
                return None, f"{name}: the angle is not a number"
            return BendTo(angle_deg), ""
        numbers = ", ".join(f"{value:g}" for value in params[:4])
        return None, f"no rule for {name} ({numbers})"

    def item_trigger(self, t: float, execution: Execution, command: MavlinkMessage | None = None) -> Trigger:
        """The trigger of a mission item that ran. `command` is the COMMAND_LONG that announced it, if any."""
        intent, problem = self.for_command(execution.command, execution.params)
        what: dict[str, object] = {"seq": execution.seq, "command": execution.command}
        if execution.params is not None:
            what["params"] = list(execution.params[:4])
        if execution.age_s > LATE_S:
            what["late_s"] = round(execution.age_s, 1)
        return Trigger(t, "mission_item", what, intent, problem, command=command, age_s=execution.age_s)


def direct_intent(command: int, params: Sequence[float]) -> tuple[Intent | None, str] | None:
    """The intent of one of the fixed commands of this component; None for any other command."""
    value = params[0]
    if command == BEND_TO:
        return (BendTo(value), "") if math.isfinite(value) else (None, "the angle is not a number")
    if command == SET_PRESSURE:
        return (SetPressure(value), "") if math.isfinite(value) else (None, "the pressure is not a number")
    choices = CHOICES.get(command)
    if choices is None:
        return None
    for number, (_, intent) in enumerate(choices):
        if intent is not None and value == number:
            return intent, ""
    offered = ", ".join(f"{n} ({name})" for n, (name, intent) in enumerate(choices) if intent is not None)
    return None, f"param1 must be one of {offered}"


def _matches(wanted: Mapping[Param, float], params: Sequence[float]) -> bool:
    return all(
        math.isclose(_param(params, key), value, rel_tol=FLOAT32, abs_tol=FLOAT32)
        for key, value in wanted.items()
    )


def _param(params: Sequence[float], key: Param) -> float:
    index = param_index(key)
    return params[index] if index < len(params) else 0.0


GAP_S = 3.0


class TriggerCondition(Protocol):
    """A condition in the autopilot's messages. It starts the configured profile, unless safety refuses."""

    messages: Collection[str]
    """The names of the MAVLink messages that it needs."""

    def holds(self, t: float, message: MavlinkMessage) -> bool:
        """Whether the condition holds after this message, which came at `t` (seconds)."""


class OwnTrigger:
    """One entry of the configuration's `[[triggers]]`. Raises `PluginError`."""

    def __init__(self, index: int, config: TriggerConfig) -> None:
        self.name = f"trigger {config.kind}" + (f" {index}" if index else "")
        self._config = config
        key = f"triggers[{index}].kind"
        make = find("triggers", config.kind, key, "messages", "holds")
        self._condition: TriggerCondition = make(**config.settings)
        known = {kind.msgname: number for number, kind in mavlink.mavlink_map.items()}
        if unknown := sorted(set(self._condition.messages) - known.keys()):
            raise PluginError(f"{key}: {config.kind} needs unknown MAVLink messages: {', '.join(unknown)}")
        self.messages = {name: known[name] for name in self._condition.messages}
        """Names and ids."""
        self._held, self._took_at = True, -math.inf

    def take(self, t: float, message: MavlinkMessage) -> Trigger | None:
        """A trigger when the condition begins to hold. Call it with each of the `messages` of our autopilot.

        If the condition already holds at the first message, or at the first message after a gap of `GAP_S`,
        there is no trigger.
        """
        held = self._held or t - self._took_at > GAP_S
        self._held, self._took_at = bool(self._condition.holds(t, message)), t
        if held or not self._held:
            return None
        what: dict[str, object] = {"name": self._config.kind, "message": message.get_type()}
        return Trigger(t, "trigger", what, StartProfile(self._config.profile))


def own_triggers(configs: Sequence[TriggerConfig]) -> tuple[OwnTrigger, ...]:
    """The triggers of installed packages that the configuration names. Raises `PluginError`."""
    return tuple(OwnTrigger(index, config) for index, config in enumerate(configs))


def messages_of(triggers: Iterable[OwnTrigger]) -> dict[str, int]:
    """Names and ids of all messages that these triggers need."""
    return {name: number for trigger in triggers for name, number in trigger.messages.items()}
