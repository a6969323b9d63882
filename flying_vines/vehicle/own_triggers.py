"""Triggers of installed packages: a condition in the autopilot's messages starts a profile."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from typing import Protocol

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config.config import TriggerConfig
from flying_vines.config.plugins import PluginError, find
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.triggers import Trigger
from flying_vines.vine.intent import StartProfile

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
