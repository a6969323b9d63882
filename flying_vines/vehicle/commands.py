"""Commands that reach us: which are for us, which are copies, what they ask, what the sender is told."""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.codec import Message
from flying_vines.vehicle.mission.execution import Execution
from flying_vines.vehicle.mission.px4 import Px4Watch
from flying_vines.vehicle.triggers import Rules, Trigger, direct_intent

COPIES_WITHIN_S = 6.0
"""PX4 repeats an unacknowledged command three times, mostly 0.5 s apart; ground stations every 3 s or so. The
confirmation field counts them."""
OVERTAKEN_WITHIN_S = 0.6
"""A first copy can arrive this much later than the repeat that overtook it."""

_Key = tuple[object, ...]


class Commands:
    """Turns COMMAND_LONG and COMMAND_INT into triggers, each once, and owes each copy an answer."""

    def __init__(self, rules: Rules, component_id: int) -> None:
        self._rules = rules
        self._component_id = component_id
        self._seen: dict[_Key, tuple[float, bool]] = {}
        self._results: dict[_Key, int] = {}

    def handle(
        self, t: float, message: Message, system_id: int, from_autopilot: bool, px4: Px4Watch | None
    ) -> list[Trigger | Message]:
        """A trigger, or the answer where there is nothing to decide.

        A mission item that the autopilot publishes is addressed to no component (PX4) or to us (a script).
        `px4` is None where the autopilot tells its items in another way: then what it says to no component
        (ArduPilot's camera commands) would be heard twice.
        """
        to_us = message.target_system == system_id and message.target_component == self._component_id
        to_all = px4 and message.target_system in (0, system_id) and message.target_component == 0
        is_item = from_autopilot and message.command in self._rules.commands
        if not to_us and not (to_all and is_item):
            return []
        if self._is_copy(t, message):
            result = self._results.get(_key(message), mavlink.MAV_RESULT_ACCEPTED)
            return [_answer(message, result)]
        params = _params(message)
        if is_item:
            execution = (
                px4.execution(message.command, params)
                if px4
                else Execution(message.command, None, None, params)
            )
            return [self._rules.item_trigger(t, execution, message)]
        found = direct_intent(message.command, params)
        if found is None and message.command in self._rules.commands:
            found = self._rules.for_command(message.command, params)
        if found is None:
            self._results[_key(message)] = mavlink.MAV_RESULT_UNSUPPORTED
            return [_answer(message, mavlink.MAV_RESULT_UNSUPPORTED)]
        sender = f"{message.get_srcSystem()}/{message.get_srcComponent()}"
        what: dict[str, object] = {"command": message.command, "params": list(params), "from": sender}
        return [Trigger(t, "command", what, *found, by_person=not from_autopilot, command=message)]

    def acknowledge(self, trigger: Trigger, accepted: bool) -> list[Message]:
        """The COMMAND_ACK for the command behind a trigger, if there is one."""
        if trigger.command is None:
            return []
        result = mavlink.MAV_RESULT_ACCEPTED if accepted else mavlink.MAV_RESULT_DENIED
        self._results[_key(trigger.command)] = result
        return [_answer(trigger.command, result)]

    def _is_copy(self, t: float, message: Message) -> bool:
        self._seen = {key: seen for key, seen in self._seen.items() if t - seen[0] < COPIES_WITHIN_S}
        self._results = {key: result for key, result in self._results.items() if key in self._seen}
        key = _key(message)
        first = getattr(message, "confirmation", 0) == 0
        last_at, saw_first = self._seen.get(key, (-math.inf, False))
        copy = (not saw_first and t - last_at < OVERTAKEN_WITHIN_S) if first else last_at > -math.inf
        self._seen[key] = (t, first or (copy and saw_first))
        return copy


def _params(message: Message) -> tuple[float, float, float, float]:
    return (message.param1, message.param2, message.param3, message.param4)


def _key(message: Message) -> _Key:
    numbers = tuple("nan" if math.isnan(value) else value for value in _params(message))
    return (message.get_srcSystem(), message.get_srcComponent(), message.command, *numbers)


def _answer(message: Message, result: int) -> Message:
    return mavlink.MAVLink_command_ack_message(
        message.command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent()
    )
