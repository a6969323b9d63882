"""Whether the radio link to the pilot can be believed.

An autopilot whose RC is lost keeps sending RC_CHANNELS with frozen values (ArduPilot), stops sending them
(PX4), or sends what the receiver makes up. So several signs are weighed, and one that says "lost" is enough.
"""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config import Switch
from flying_vines.vehicle.codec import Message

RC_BIT = mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
LOWEST_US, HIGHEST_US = 800, 2200
TEXT_OUTLIVED_BY_HEALTH_S = 1.5
"""Good health that is reported this long after a "Radio Failsafe" means that its "Cleared" was lost."""


class RadioLink:
    """Weighs RC_CHANNELS, SYS_STATUS and status texts; `switch_us` is the switch's latest pulse width."""

    def __init__(self, switch: Switch, silent_after_s: float) -> None:
        self.configure(switch, silent_after_s)
        self._heard_at: float | None = None
        self._healthy = True
        self._failsafe_text_at: float | None = None
        self._throttle_us = 0
        self._chancount = 0
        self.switch_us = 0

    def configure(self, switch: Switch, silent_after_s: float) -> None:
        """Look at this switch's channel from the next message on."""
        self._channel = f"chan{switch.channel}_raw"
        self._channel_number = switch.channel
        self._throttle = f"chan{switch.throttle_channel}_raw" if switch.throttle_channel else None
        self._throttle_failsafe_us = switch.throttle_failsafe_us
        self._silent_after_s = silent_after_s

    def handle(self, t: float, message: Message) -> None:
        """Take in a message of our autopilot."""
        kind = message.get_type()
        if kind == "RC_CHANNELS":
            self._heard_at = t
            self._chancount = message.chancount
            self.switch_us = getattr(message, self._channel)
            self._throttle_us = getattr(message, self._throttle) if self._throttle else 0
        elif kind == "SYS_STATUS":
            present = message.onboard_control_sensors_present & RC_BIT
            enabled = message.onboard_control_sensors_enabled & RC_BIT
            self._healthy = bool(message.onboard_control_sensors_health & RC_BIT) or not (present and enabled)
            good = self._healthy and present and enabled
            said_at = self._failsafe_text_at
            if good and said_at is not None and t - said_at > TEXT_OUTLIVED_BY_HEALTH_S:
                self._failsafe_text_at = None
        elif kind == "STATUSTEXT" and message.text.startswith("Radio Failsafe"):
            self._failsafe_text_at = None if "Cleared" in message.text else t

    def forget(self) -> None:
        """The autopilot rebooted or vanished: nothing that was heard holds any more."""
        self._heard_at = None
        self._healthy = True
        self._failsafe_text_at = None

    def problem(self, t: float) -> str | None:
        """Why the switch cannot be believed at time `t`; None when it can."""
        if self._heard_at is None:
            return "no RC_CHANNELS yet"
        if t - self._heard_at > self._silent_after_s:
            return f"no RC_CHANNELS for {self._silent_after_s:g} s"
        if self._failsafe_text_at is not None:
            return "radio failsafe"
        if not self._healthy:
            return "the autopilot reports RC lost"
        if self._chancount == 0:
            return "the receiver has no channels"
        if not LOWEST_US <= self.switch_us <= HIGHEST_US:
            return f"channel {self._channel_number} is not there ({self.switch_us})"
        if self._throttle and 0 < self._throttle_us < self._throttle_failsafe_us:
            return f"throttle at {self._throttle_us}: receiver in failsafe"
        return None
