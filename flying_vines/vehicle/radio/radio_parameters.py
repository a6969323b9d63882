"""Reads the autopilot's parameters about RC: those that can hide a loss, and the flight mode's channel."""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.autopilots.autopilot import Autopilot
from flying_vines.vehicle.mavlink.codec import MavlinkMessage

ASK_SPACING_S = 0.2
ASK_AGAIN_S = 2.0
MAX_ATTEMPTS = 5
"""Maximum number of requests for a parameter. An autopilot that does not have it does not answer."""


class RadioParameters:
    """The values of the autopilot's `rc_parameters`, which `Autopilot.hides_rc_loss` interprets, of its
    `mode_channel_parameter`, and of those about other uses of the switch's `channel`."""

    def __init__(self, channel: int) -> None:
        self.channel = channel
        self.values: dict[str, float] = {}
        self._attempts: dict[str, int] = {}
        self._asked_at = -math.inf
        self._round_at = -math.inf

    def forget(self) -> None:
        """Forget the values: the autopilot rebooted."""
        self.values = {}
        self.refresh()

    def refresh(self) -> None:
        """Request all values again."""
        self._attempts = {}
        self._asked_at = self._round_at = -math.inf

    def handle(self, autopilot: Autopilot, message: MavlinkMessage) -> bool:
        """Take in a PARAM_VALUE of our autopilot. Returns True if it changed a value."""
        name = message.param_id
        if name not in self._names(autopilot):
            return False
        value = autopilot.parameter_value(message)
        if not math.isfinite(value):
            return False
        self._attempts[name] = MAX_ATTEMPTS
        changed = self.values.get(name) != value
        self.values[name] = value
        return changed

    def requests(self, t: float, system_id: int, autopilot: Autopilot) -> list[MavlinkMessage]:
        """At most one request per call."""
        if t - self._asked_at < ASK_SPACING_S:
            return []
        due = [name for name in self._names(autopilot) if self._attempts.get(name, 0) < MAX_ATTEMPTS]
        if not due:
            return []
        name = min(due, key=lambda name: self._attempts.get(name, 0))
        if self._attempts.get(name, 0) > 0 and t - self._round_at < ASK_AGAIN_S:
            return []
        if name == due[0]:
            self._round_at = t
        self._attempts[name] = self._attempts.get(name, 0) + 1
        self._asked_at = t
        return [mavlink.MAVLink_param_request_read_message(system_id, 1, name.encode(), -1)]

    def _names(self, autopilot: Autopilot) -> list[str]:
        uses = (name.format(self.channel) for name in autopilot.other_uses)
        return [name for name in (*autopilot.rc_parameters, autopilot.mode_channel_parameter, *uses) if name]
