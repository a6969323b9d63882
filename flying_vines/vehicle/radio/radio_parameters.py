"""The autopilot's parameters that say whether a lost transmitter shows: read from it, and read again."""

from __future__ import annotations

import math
import struct

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.mavlink.codec import Message

NAMES = {
    "ardupilot": ("FS_THR_ENABLE", "RC_FS_TIMEOUT", "RC_OPTIONS", "RC_OVERRIDE_TIME"),
    "px4": ("COM_RC_LOSS_T", "COM_RC_IN_MODE"),
}
ASK_SPACING_S = 0.2
ASK_AGAIN_S = 2.0
MOST_ATTEMPTS = 5
"""An autopilot that has no such parameter does not answer."""

SHOWN_WITHIN_S = 2.0
"""A loss that shows later than this can hide a move of the switch."""
IGNORE_RECEIVER, IGNORE_OVERRIDES, IGNORE_FAILSAFE_FLAG = 1, 2, 4
"""Bits of ArduPilot's RC_OPTIONS."""
RECEIVER_NOT_USED = {1: "joystick only", 4: "stick input disabled"}
"""Values of PX4's COM_RC_IN_MODE with which its RC status says nothing about the receiver."""
DEFAULT_OVERRIDE_S = 3.0
PX4_DEFAULT_LOSS_S = 0.5
PX4_STATUS_AFTER_S = 1.1
"""From the end of COM_RC_LOSS_T to the status in SYS_STATUS. Measured: the status changes 0.8 to 1.4 s
after a loss with COM_RC_LOSS_T = 0.5 s."""


class RadioParameters:
    """Asks for what `NAMES` lists, and says what follows from the values."""

    def __init__(self) -> None:
        self.values: dict[str, float] = {}
        self._attempts: dict[str, int] = {}
        self._asked_at = -math.inf
        self._round_at = -math.inf

    def forget(self) -> None:
        """The autopilot is another one, or has booted again."""
        self.values = {}
        self.refresh()

    def refresh(self) -> None:
        """Ask for all of them again."""
        self._attempts = {}
        self._asked_at = self._round_at = -math.inf

    def handle(self, autopilot: str, message: Message) -> bool:
        """Take in a PARAM_VALUE of our autopilot; whether it changed anything."""
        name = message.param_id
        if name not in NAMES.get(autopilot, ()):
            return False
        value = _value(autopilot, message)
        if not math.isfinite(value):
            return False
        self._attempts[name] = MOST_ATTEMPTS
        changed = self.values.get(name) != value
        self.values[name] = value
        return changed

    def requests(self, t: float, system_id: int, autopilot: str) -> list[Message]:
        """At most one request a call."""
        if t - self._asked_at < ASK_SPACING_S:
            return []
        due = [name for name in NAMES.get(autopilot, ()) if self._attempts.get(name, 0) < MOST_ATTEMPTS]
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

    @property
    def hides_loss(self) -> str:
        """Which parameter lets the autopilot hide a lost transmitter; empty if none is known to."""
        values = self.values
        if values.get("FS_THR_ENABLE") == 0:
            return "FS_THR_ENABLE 0"
        if values.get("RC_FS_TIMEOUT", 0.0) > SHOWN_WITHIN_S:
            return f"RC_FS_TIMEOUT {values['RC_FS_TIMEOUT']:g}"
        options = int(values.get("RC_OPTIONS", 0))
        if options & (IGNORE_RECEIVER | IGNORE_FAILSAFE_FLAG):
            return f"RC_OPTIONS {options}"
        if (mode := int(values.get("COM_RC_IN_MODE", 0))) in RECEIVER_NOT_USED:
            return f"COM_RC_IN_MODE {mode}"
        return ""

    @property
    def override_lasts_s(self) -> float:
        """How long ArduPilot keeps a ground station's override; 0 if it takes none."""
        if int(self.values.get("RC_OPTIONS", 0)) & IGNORE_OVERRIDES:
            return 0.0
        lasts_s = self.values.get("RC_OVERRIDE_TIME", DEFAULT_OVERRIDE_S)
        return math.inf if lasts_s < 0.0 else lasts_s

    @property
    def px4_shows_loss_within_s(self) -> float:
        """By when PX4's RC status has told of a lost transmitter."""
        return PX4_STATUS_AFTER_S + max(PX4_DEFAULT_LOSS_S, self.values.get("COM_RC_LOSS_T", 0.0))


def _value(autopilot: str, message: Message) -> float:
    """PX4 sends an integer's bytes in the place of the float."""
    if autopilot == "px4" and message.param_type == mavlink.MAV_PARAM_TYPE_INT32:
        return float(struct.unpack("<i", struct.pack("<f", message.param_value))[0])
    return float(message.param_value)
