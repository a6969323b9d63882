"""Commands to us: new or repeated, their intents, and the acknowledgements."""

from __future__ import annotations

import math
from dataclasses import replace

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.autopilots.autopilot import MissionWatch
from flying_vines.vehicle.clock import LATE_S
from flying_vines.vehicle.component.senders import Sender
from flying_vines.vehicle.component.transmit_queue import acknowledgement
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.repeats import PX4_REPEAT_S, STATION_REPEAT_S, Repeats
from flying_vines.vehicle.triggers import Rules, Trigger, direct_intent
from flying_vines.vine.intent import Intent

_Key = tuple[object, ...]


class CommandReceiver:
    """Turns a COMMAND_LONG or COMMAND_INT into a trigger.

    A repeat gets only an acknowledgement, unless it deflates the vine.
    """

    def __init__(self, rules: Rules, component_id: int) -> None:
        self._rules = rules
        self._component_id = component_id
        self._repeats = Repeats()

    def handle(
        self,
        t: float,
        message: MavlinkMessage,
        system_id: int,
        sender: Sender,
        watch: MissionWatch,
        age_s: float = 0.0,
    ) -> list[Trigger | MavlinkMessage]:
        """A trigger, or the acknowledgement if there is nothing to decide. Empty for a command to others.

        Every sender may deflate the vine; `Sender.refusal` says who may do more.

        PX4 sends mission items to component 0. A script on an ArduPilot sends them to our component id.
        Of other broadcasts only our own commands that deflate the vine are for us: a bend needs our ids.
        `age_s` is the age of the message.
        """
        system, component = message.target_system, message.target_component
        if system not in (0, system_id) or component not in (0, self._component_id):
            return []
        params = _params(message)
        is_item = sender.is_autopilot and message.command in self._rules.commands
        if not (system and component):
            is_broadcast_item = is_item and watch.publishes_items and component == 0
            intent, _ = direct_intent(message.command, params) or (None, "")
            if not is_broadcast_item and not self._rules.only_deflates(intent):
                return []
        confirmation = getattr(message, "confirmation", 0)
        repeat_s = PX4_REPEAT_S if sender.is_autopilot else STATION_REPEAT_S
        repeat = self._repeats.is_repeat(t, _key(message), confirmation, message.get_seq(), repeat_s)
        if repeat and (is_item or not self._only_deflates(message.command, params)):
            result = self._repeats.answered(_key(message))
            return [acknowledgement(message, mavlink.MAV_RESULT_ACCEPTED if result is None else result)]
        if is_item:
            execution = watch.command(t, message.command, params, confirmation)
            if execution is None:
                return [acknowledgement(message, mavlink.MAV_RESULT_ACCEPTED)]
            execution = replace(execution, age_s=execution.age_s + age_s)
            return [self._rules.item_trigger(t, execution, message)]
        intent_or_problem = self._intent(message.command, params)
        if intent_or_problem is None:
            self._repeats.answer(_key(message), mavlink.MAV_RESULT_UNSUPPORTED)
            return [acknowledgement(message, mavlink.MAV_RESULT_UNSUPPORTED)]
        what = {"command": message.command, "params": list(params[:4]), "from": sender.name}
        if age_s > LATE_S:
            what["late_s"] = round(age_s, 1)
        intent, problem = intent_or_problem
        if not problem and not self._rules.only_deflates(intent):
            problem = sender.refusal
        # A repeat may be old: it must not clear faults that its sender has not seen.
        by_person = sender.is_station and not repeat
        trigger = Trigger(t, "command", what, intent, problem, by_person, message, age_s, seen_at=t - age_s)
        return [trigger]

    def _intent(self, command: int, params: tuple[float, ...]) -> tuple[Intent | None, str] | None:
        """The intent, or None and the problem. Returns None alone if this is not one of our commands."""
        found = direct_intent(command, params)
        if found is None and command in self._rules.commands:
            found = self._rules.for_command(command, params)
        return found

    def _only_deflates(self, command: int, params: tuple[float, ...]) -> bool:
        """True if the command only deflates. Then it runs even as a repeat: it may be a new request."""
        intent, _ = self._intent(command, params) or (None, "")
        return self._rules.only_deflates(intent)

    def acknowledge(self, trigger: Trigger, accepted: bool) -> list[MavlinkMessage]:
        """The COMMAND_ACK for the command behind a trigger, if there is one."""
        if trigger.command is None:
            return []
        result = mavlink.MAV_RESULT_ACCEPTED if accepted else mavlink.MAV_RESULT_DENIED
        self._repeats.answer(_key(trigger.command), result)
        lets_air_out = accepted and self._rules.only_deflates(trigger.intent)
        return [acknowledgement(trigger.command, result, lets_air_out=lets_air_out)]


def _params(message: MavlinkMessage) -> tuple[float, ...]:
    first = (message.param1, message.param2, message.param3, message.param4)
    if message.get_type() == "COMMAND_INT":
        return (*first, float(message.x), float(message.y), message.z)
    return (*first, message.param5, message.param6, message.param7)


def _key(message: MavlinkMessage) -> _Key:
    numbers = tuple("nan" if math.isnan(value) else value for value in _params(message))
    return (message.get_srcSystem(), message.get_srcComponent(), message.command, *numbers)
