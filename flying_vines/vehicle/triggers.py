"""From what the vehicle does to what the vine shall do: the configuration's tables, applied."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from flying_vines.config import CARRIERS, Config
from flying_vines.intent import BendTo, ClearFaults, Hold, Intent, SetPressure, StartProfile, Vent
from flying_vines.vehicle.codec import Message
from flying_vines.vehicle.mission.execution import Execution

NAME_OF_COMMAND = {number: name for name, number in CARRIERS.items()}
BEND_TO, SET_PRESSURE, STOP, CLEAR = (CARRIERS[f"user_{n}"] for n in (2, 3, 4, 5))


@dataclass(frozen=True, slots=True)
class Trigger:
    """Something asked for a bend: what it was, and what it wants.

    `intent` is None when nothing can be made of it, and `problem` then says why.
    """

    t: float
    kind: str
    what: dict[str, object]
    intent: Intent | None
    problem: str = ""
    by_person: bool = False
    command: Message | None = None
    """The command that waits for an acknowledgement."""

    def __str__(self) -> str:
        return self.kind + " " + " ".join(f"{key}={value}" for key, value in self.what.items())


class Rules:
    """The `[switch]` and `[[items]]` tables."""

    def __init__(self, config: Config) -> None:
        self._items = config.items
        self._positions = config.switch.positions
        self.commands = {item.command_id for item in config.items}

    def for_position(self, position: int) -> Intent | None:
        """What a switch position asks for; None where the configuration leaves it empty."""
        name = self._positions[position]
        return StartProfile(name) if name else None

    def for_command(self, command: int, params: Sequence[float] | None) -> tuple[Intent | None, str]:
        """The intent of a mission item or command, or None and why there is none."""
        name = NAME_OF_COMMAND.get(command, str(command))
        if params is None:
            return None, f"{name}: its numbers are not known, the mission was not read"
        for item in self._items:
            if item.command_id != command or not _matches(item.match, params):
                continue
            if item.profile is not None:
                return StartProfile(item.profile), ""
            angle_deg = _param(params, item.bend or "param1") * item.scale
            if not math.isfinite(angle_deg):
                return None, f"{name}: the angle is not a number"
            return BendTo(angle_deg), ""
        numbers = ", ".join(f"{value:g}" for value in params[:4])
        return None, f"no rule for {name} ({numbers})"

    def item_trigger(self, t: float, execution: Execution, command: Message | None = None) -> Trigger:
        """The trigger of a mission item that ran, and of the command that published it."""
        intent, problem = self.for_command(execution.command, execution.params)
        what: dict[str, object] = {"seq": execution.seq, "command": execution.command}
        if execution.params is not None:
            what["params"] = list(execution.params[:4])
        return Trigger(t, "mission_item", what, intent, problem, command=command)


def direct_intent(command: int, params: Sequence[float]) -> tuple[Intent | None, str] | None:
    """The fixed commands of this component; None where `command` is none of them."""
    value = params[0]
    if command == BEND_TO:
        return (BendTo(value), "") if math.isfinite(value) else (None, "the angle is not a number")
    if command == SET_PRESSURE:
        return (SetPressure(value), "") if math.isfinite(value) else (None, "the pressure is not a number")
    if command == STOP:
        if value in (0, 1):
            return (Hold() if value else Vent(), "")
        return None, "param1 must be 0 (vent) or 1 (hold)"
    if command == CLEAR:
        return (ClearFaults(), "") if value == 1 else (None, "param1 must be 1 (clear faults)")
    return None


def _matches(wanted: dict[str, float] | object, params: Sequence[float]) -> bool:
    assert isinstance(wanted, dict)
    return all(math.isclose(_param(params, key), value, abs_tol=1e-6) for key, value in wanted.items())


def _param(params: Sequence[float], key: str) -> float:
    return params[int(key.removeprefix("param")) - 1]
