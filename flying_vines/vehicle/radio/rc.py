"""Checks the radio link to the pilot.

After a loss of RC an autopilot continues to send RC_CHANNELS, with the last values or the receiver's preset.
So several signs are checked, and one sign of a loss is enough.
"""

from __future__ import annotations

import math
from operator import attrgetter

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config.config import SwitchConfig
from flying_vines.vehicle.autopilots import OTHER
from flying_vines.vehicle.autopilots.autopilot import Autopilot
from flying_vines.vehicle.mavlink.codec import MavlinkMessage

RC_BIT = mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
MIN_US, MAX_US = 800, 2200
_NO_PULSE = (0, 0xFFFF)
CHANNELS = 18
_PULSES_US = attrgetter(*(f"chan{number}_raw" for number in range(1, CHANNELS + 1)))
HEALTH_CLEARS_FAILSAFE_S = 1.5
"""The text "Cleared" may be lost. Good health this long after "Radio Failsafe" also clears the failsafe."""

JUMP_US = 150
"""A receiver's preset moves a channel by this or more within one period of RC_CHANNELS; a stick does not."""
MIN_JUMPED = 2
"""This many other channels must jump with the switch."""

OUT_OF_ORDER_S = 2.0
"""Two paths of a link differ by less than this. A clock that goes back by more has started again."""

OVERRIDE_RSSI = 100
"""PX4's rssi while RC comes from a ground station's RC_CHANNELS_OVERRIDE."""
NO_SIGNAL, NO_RSSI = 0, 255
RSSI_WARNS_FOR_S = 3.0
"""A missing rssi (255) counts as a loss for this time. After that, PX4's RC status is up to date."""


class RadioLink:
    """Checks RC_CHANNELS, SYS_STATUS and status texts; `switch_us` is the switch's latest pulse width.

    `autopilot` is the sender of these messages, if it is known.

    PX4's RC status (present, enabled, health) is (1, 1, 1) while a receiver is good, and (0, 1, 0) after a
    loss. The same holds for RC of a ground station if PX4's RC is calibrated; else it stays (0, 1, 0), and is
    ignored. RC_CHANNELS stops when such RC is lost.
    """

    def __init__(self, switch: SwitchConfig, silent_after_s: float) -> None:
        self.configure(switch, silent_after_s)
        self.autopilot = OTHER
        self.switch_us = 0
        self.stamp_s = 0.0
        """When the autopilot sent the latest RC_CHANNELS, by its own clock."""
        self.jumped = False
        """Several other channels jumped in the latest RC_CHANNELS."""
        self.forget()

    def configure(self, switch: SwitchConfig, silent_after_s: float) -> None:
        """Use this switch's channel from the next message on."""
        self._channel_number = switch.channel
        self._throttle_channel = switch.throttle_channel
        self._throttle_failsafe_us = switch.throttle_failsafe_us
        self._silent_after_s = silent_after_s

    def forget(self) -> None:
        """Forget everything: the autopilot rebooted or was lost."""
        self._received_at: float | None = None
        self._interrupted = False
        self._channels_us: tuple[int, ...] = ()
        self._throttle_seen = False
        """The throttle had a pulse. A receiver may give none for it in a failsafe, and hold the switch."""
        self._chancount = 0
        self._rssi = NO_RSSI
        self._rssi_known = False
        self._rssi_lost_at: float | None = None
        self._status: bool | None = None
        self._unhealthy = False
        self._status_was_good = False
        self._health: tuple[int, ...] | None = None
        self._health_stamp_s = -math.inf
        self._failsafe_text_at: float | None = None

    @property
    def by_receiver(self) -> bool:
        """True if the RC status has shown a good receiver since the autopilot booted."""
        return self._status_was_good

    @property
    def by_station(self) -> bool:
        """True if RC comes from a ground station, which PX4's RC status does not cover."""
        no_receiver = self.autopilot.needs_rc_status and not self._status_was_good
        return no_receiver and self._received_at is not None and self._rssi == OVERRIDE_RSSI

    def handle(self, t: float, message: MavlinkMessage) -> None:
        """Take in a message of our autopilot."""
        kind = message.get_type()
        if kind == "RC_CHANNELS":
            self._take_channels(t, message)
        elif kind == "SYS_STATUS":
            self._take_status(t, message)
            self._take_health(message)
        elif kind == "STATUSTEXT" and message.text.startswith("Radio Failsafe"):
            self._failsafe_text_at = None if "Cleared" in message.text else t

    def is_outdated(self, message: MavlinkMessage) -> bool:
        """True for RC_CHANNELS that left the autopilot before the latest one: they took a slower path."""
        stamp_s: float = message.time_boot_ms / 1000.0
        return 0.0 < self.stamp_s - stamp_s < OUT_OF_ORDER_S

    def health_changed_since(self, stamp_s: float) -> bool:
        """True if SYS_STATUS has changed for any sensor since `stamp_s` of the autopilot's clock."""
        return self._health_stamp_s >= stamp_s

    def take_interruption(self) -> bool:
        """True if RC was lost since the last call, even if it is good again."""
        interrupted, self._interrupted = self._interrupted, False
        return interrupted

    def problem(self, t: float) -> str | None:
        """Why the switch cannot be trusted at time `t`; None if it can."""
        if self._received_at is None:
            return "no RC_CHANNELS yet"
        if t - self._received_at > self._silent_after_s:
            return f"no RC_CHANNELS for {self._silent_after_s:g} s"
        if self._failsafe_text_at is not None:
            return "radio failsafe"
        if self._unhealthy:
            return "the autopilot reports RC lost"
        if self._receiver_hears_nothing(t):
            return "the receiver hears no transmitter"
        if self.autopilot.needs_rc_status and not (self._status_was_good or self.by_station):
            return "no RC status yet" if self._status is None else "the autopilot reports no receiver"
        if self._chancount == 0:
            return "the receiver has no channels"
        if not MIN_US <= self.switch_us <= MAX_US:
            return f"channel {self._channel_number} has no valid pulse ({self.switch_us})"
        throttle_us = self._channels_us[self._throttle_channel - 1] if self._throttle_channel else 0
        if 0 < throttle_us < self._throttle_failsafe_us:
            return f"throttle at {throttle_us}: receiver in failsafe"
        if self._throttle_seen and throttle_us in _NO_PULSE:
            return "the throttle has no pulse: receiver in failsafe"
        return None

    def _take_channels(self, t: float, message: MavlinkMessage) -> None:
        # While our process stalls, nobody calls `problem`. So a long gap itself counts as a loss.
        if self._received_at is not None and t - self._received_at > self._silent_after_s:
            self._interrupted = True
        channels_us: tuple[int, ...] = _PULSES_US(message)
        self.jumped = self._jumped_with_switch(channels_us)
        self._received_at, self._channels_us = t, channels_us
        self._chancount = message.chancount
        throttle_us = channels_us[self._throttle_channel - 1] if self._throttle_channel else 0
        self._throttle_seen |= throttle_us not in _NO_PULSE
        self.switch_us = channels_us[self._channel_number - 1]
        self.stamp_s = message.time_boot_ms / 1000.0
        if self.autopilot.needs_rc_status:
            self._take_rssi(t, message.rssi)

    def _jumped_with_switch(self, channels_us: tuple[int, ...]) -> bool:
        if channels_us == self._channels_us:
            return False
        jumped = 0
        for number, (now_us, before_us) in enumerate(zip(channels_us, self._channels_us, strict=False), 1):
            if abs(now_us - before_us) >= JUMP_US and number != self._channel_number:
                jumped += min(now_us, before_us) >= MIN_US
        return jumped >= MIN_JUMPED

    def _take_rssi(self, t: float, rssi: int) -> None:
        """A receiver's rssi shows a loss earlier than the RC status. Sometimes it is the only sign."""
        if rssi not in (NO_SIGNAL, NO_RSSI):
            self._rssi_known = self._status_was_good
            self._rssi_lost_at = None
        elif self._rssi_known and rssi != self._rssi:
            self._rssi_lost_at = t
            self._interrupted = True
        self._rssi = rssi

    def _receiver_hears_nothing(self, t: float) -> bool:
        if self._rssi_lost_at is None:
            return False
        return self._rssi == NO_SIGNAL or t - self._rssi_lost_at < RSSI_WARNS_FOR_S

    def _take_health(self, message: MavlinkMessage) -> None:
        health = (
            message.onboard_control_sensors_present,
            message.onboard_control_sensors_enabled,
            message.onboard_control_sensors_health,
        )
        if self._health not in (None, health):
            self._health_stamp_s = self.stamp_s
        self._health = health

    def _take_status(self, t: float, message: MavlinkMessage) -> None:
        present = bool(message.onboard_control_sensors_present & RC_BIT)
        enabled = bool(message.onboard_control_sensors_enabled & RC_BIT)
        health = bool(message.onboard_control_sensors_health & RC_BIT)
        self._status = good = present and enabled and health
        self._unhealthy = not good and ((present and enabled) or self._status_was_good)
        if not good:
            return
        if not self._status_was_good:
            self._status_was_good = True
            # Channel values before the first good status may be failsafe values.
            self._interrupted |= self.autopilot.needs_rc_status
        text_at = self._failsafe_text_at
        if text_at is not None and t - text_at > HEALTH_CLEARS_FAILSAFE_S:
            self._failsafe_text_at = None


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
