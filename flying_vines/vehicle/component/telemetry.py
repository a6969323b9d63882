"""Messages at a fixed rate: heartbeat and named values."""

from __future__ import annotations

import math
from collections.abc import Mapping

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.clock import SILENCE_S
from flying_vines.vehicle.mavlink.codec import MavlinkMessage

VALUE_NAMES = ("RES_KPA", "CYC_LEFT", "MIN_LEFT", "CV_KPA", "CMD_KPA", "BEND_DEG")
"""The names of NAMED_VALUE_FLOAT, 10 characters at most. docs/mavlink.md says what they mean."""
HEARTBEAT_S = 1.0
MIN_PERIOD_S, MAX_PERIOD_S = 0.1, 10.0
"""The periods that a ground station may request for the named values."""
SLOW_S, MUTED_S = 5.0, 60.0
"""A period above `SLOW_S`, or none, lasts for `MUTED_S`. Then the usual one is back, because all ground
stations share this stream. A ground station that wants it for longer repeats its request."""
ONCE_SPACING_S = 0.1
LATE_S = 0.1
"""After a longer delay the schedule restarts from now. So no burst follows a stall."""
_TICK_GRAIN_S = 0.001


class Heartbeat:
    """HEARTBEAT once a second.

    It is also sent at once when the autopilot appears, or is back after a silence. Until an ArduPilot has
    received our heartbeat, it executes commands meant for us. After a reboot it does not know us.
    """

    def __init__(self) -> None:
        self._sent_at = -math.inf
        self._autopilot_at = -math.inf

    def autopilot_spoke(self, t: float) -> None:
        """A heartbeat of the autopilot arrived."""
        if t - self._autopilot_at > SILENCE_S:
            self.now()
        self._autopilot_at = t

    def now(self) -> None:
        """Make the next heartbeat due now."""
        self._sent_at = -math.inf

    def due(self, t: float, system_status: int) -> list[MavlinkMessage]:
        if t - self._sent_at < HEARTBEAT_S - _TICK_GRAIN_S:
            return []
        self._sent_at = t
        return [
            mavlink.MAVLink_heartbeat_message(
                mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, system_status, 3
            )
        ]


class NamedValues:
    """Sends each value at the same rate, evenly spread over time. An unknown value is not sent.

    We ignore incoming NAMED_VALUE_FLOAT: PX4 sends our own back to us under its id, shortened and late.
    """

    def __init__(self, usual_s: float) -> None:
        self.usual_s = usual_s
        self._requested_s: float | None = None
        self._requested_until = math.inf
        self._once_at = -math.inf
        self._last_at = -math.inf
        self._due_at: dict[str, float] = {}
        """When each value was last due. The next due time counts from here, not from the tick."""

    def period_s(self, t: float) -> float:
        """Period of each value; infinite while they are switched off."""
        if self._requested_s is None or t >= self._requested_until:
            return self.usual_s
        return self._requested_s

    def request_period(self, t: float, period_s: float | None) -> bool:
        """The period that a ground station requests; None restores the usual one. True: it ends by itself."""
        ends = period_s is not None and period_s > max(SLOW_S, self.usual_s)
        self._requested_s, self._requested_until = period_s, t + MUTED_S if ends else math.inf
        return ends

    def request_once(self, t: float) -> None:
        """Make each value due once, now."""
        self._once_at = t

    def may_send(self, t: float) -> bool:
        """False if no value can be due so soon after the last one."""
        spacing_s = min(self.period_s(t) / len(VALUE_NAMES), ONCE_SPACING_S)
        return t >= self._last_at + spacing_s - _TICK_GRAIN_S

    def due(self, t: float, time_boot_ms: int, values: Mapping[str, float]) -> list[MavlinkMessage]:
        """At most one message per call, of the most overdue value. This spreads them over time."""
        sent = {name: self._due_at.get(name, -math.inf) for name in values if math.isfinite(values[name])}
        name = min(sent, key=lambda name: sent[name], default=None)
        if name is None:
            return []
        period_s = self.period_s(t)
        spacing_s = period_s / len(values)
        if sent[name] < self._once_at:
            due_at = max(self._once_at, self._last_at + min(spacing_s, ONCE_SPACING_S))
        elif period_s == math.inf:
            return []
        else:
            due_at = max(self._last_at + spacing_s, sent[name] + period_s)
        if t < due_at - _TICK_GRAIN_S:
            return []
        if t - due_at > max(spacing_s, LATE_S):
            due_at = t
        self._due_at[name] = self._last_at = due_at
        return [mavlink.MAVLink_named_value_float_message(time_boot_ms, name.encode(), values[name])]
