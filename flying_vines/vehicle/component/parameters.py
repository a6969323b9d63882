"""The parameters as a MAVLink parameter set, which any ground station can list, read and set.

All are 32-bit floats, which ground stations encode in the same way for both autopilots. The answer is always
the present value. A request for an unknown parameter (QGroundControl's `_HASH_CHECK`) is not answered.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config.config import Config
from flying_vines.vehicle.component.parameter_table import (
    BY_NAME,
    SETTINGS,
    ParameterRefused,
    changed,
    decimal,
    same,
    value_of,
)
from flying_vines.vehicle.component.senders import Sender
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.notice import Notice, Severity
from flying_vines.vehicle.repeats import Repeats

LIST_SPACING_S = 0.1
_BY_NAME = -1
"""Index in a request by name."""


@dataclass(frozen=True, slots=True)
class Changed:
    """A parameter has a new value. `config` is the configuration with it."""

    t: float
    name: str
    value: float
    config: Config


ParameterOutput = MavlinkMessage | Notice | Changed


class Parameters:
    """The parameter set of one configuration.

    `config` is the configuration with the present values. `values` are the values that differ from `base`;
    they are saved in a file.
    """

    MESSAGES = frozenset(
        (
            mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_LIST,
            mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ,
            mavlink.MAVLINK_MSG_ID_PARAM_SET,
        )
    )
    """The messages that `handle` takes."""

    def __init__(self, base: Config, values: Mapping[str, float] | None = None) -> None:
        self.config = self._base = base
        self.values: dict[str, float] = {}
        self.mode_channel = 0
        """The RC channel of the autopilot's flight mode, which the switch cannot have; 0 if not known."""
        self._next: int | None = None
        self._listed_at = -math.inf
        self._repeats = Repeats()
        for name, value in (values or {}).items():
            self._keep(name, value)

    def handle(
        self, t: float, message: MavlinkMessage, us: tuple[int, int], sender: Sender, may_change: bool
    ) -> list[ParameterOutput]:
        """The outputs for a request.

        Args:
            t: now, in seconds.
            message: one of `MESSAGES`.
            us: the system id of our vehicle and our component id.
            sender: the sender of the message.
            may_change: the vine is vented, so parameters that affect the vine's motion may change.
        """
        kind = message.get_type()
        target = (message.target_system, message.target_component)
        to_us = target == us
        if kind == "PARAM_REQUEST_LIST":
            if to_us or target in ((us[0], 0), (0, 0)):
                self.show()
        elif to_us and kind == "PARAM_REQUEST_READ":
            return self._read(message)
        elif to_us:
            return self._set(t, message, sender, may_change)
        return []

    @property
    def showing(self) -> bool:
        """True while the list is being sent."""
        return self._next is not None

    def show(self) -> None:
        """Send the whole list. A list that is being sent starts again."""
        self._next = 0

    def due(self, t: float) -> list[MavlinkMessage]:
        if self._next is None or t - self._listed_at < LIST_SPACING_S:
            return []
        self._listed_at = t
        index = self._next
        self._next = index + 1 if index + 1 < len(SETTINGS) else None
        return [self._value(index)]

    def unbounded_changes(self) -> list[str]:
        """A sentence for each parameter that affects motion and that the configuration does not bound."""
        return [
            f"{row.name} is {value_of(row, self.config):g}, configuration: {value_of(row, self._base):g}"
            for row in SETTINGS
            if row.name in self.values and row.guard == "none" and not row.in_flight
        ]

    def _read(self, message: MavlinkMessage) -> list[ParameterOutput]:
        index = message.param_index
        if index == _BY_NAME and message.param_id in BY_NAME:
            index = SETTINGS.index(BY_NAME[message.param_id])
        return [self._value(index)] if 0 <= index < len(SETTINGS) else []

    def _set(
        self, t: float, message: MavlinkMessage, sender: Sender, may_change: bool
    ) -> list[ParameterOutput]:
        setting = BY_NAME.get(message.param_id)
        if setting is None:
            return []
        name, index = setting.name, SETTINGS.index(setting)
        before = value_of(setting, self.config)
        unchanged = same(message.param_value, before)
        key = (message.get_srcSystem(), message.get_srcComponent(), name, message.param_value)
        is_copy = self._repeats.is_repeat(t, key, 0, message.get_seq(), 0.0)
        if is_copy or (unchanged and sender.refusal):
            return [self._value(index)]
        try:
            if sender.refusal:
                raise ParameterRefused(name, sender.refusal)
            if message.param_type != mavlink.MAV_PARAM_TYPE_REAL32:
                raise ParameterRefused(name, "send it as REAL32")
            if unchanged:
                return [self._value(index)]
            if not may_change and not setting.in_flight:
                raise ParameterRefused(name, "vent the vine first")
            if name == "VINE_SW_CHAN" and message.param_value == self.mode_channel:
                raise ParameterRefused(name, f"{self.mode_channel} is the flight mode's channel")
            self._keep(name, decimal(message.param_value))
        except ParameterRefused as refusal:
            text = f"Vine: {name} stays {before:g}: {refusal.reason}"
            return [self._value(index), Notice(t, Severity.WARNING, text, source=sender.name)]
        value = value_of(setting, self.config)
        text = f"Vine: {name} is {value:g}, was {before:g}"
        return [
            self._value(index),
            Notice(t, Severity.INFO, text, source=sender.name),
            Changed(t, name, value, self.config),
        ]

    def _keep(self, name: str, value: float) -> None:
        configured = value_of(BY_NAME[name], self._base)
        if math.isfinite(value) and same(value, configured):
            self.config = changed(self._base, self.config, name, configured)
            self.values.pop(name, None)
        else:
            self.config = changed(self._base, self.config, name, value)
            self.values[name] = value

    def _value(self, index: int) -> MavlinkMessage:
        setting = SETTINGS[index]
        return mavlink.MAVLink_param_value_message(
            setting.name.encode(),
            value_of(setting, self.config),
            mavlink.MAV_PARAM_TYPE_REAL32,
            len(SETTINGS),
            index,
        )
