"""We as a well-behaved MAVLink component: heartbeat, named values, status texts, acknowledgements."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.codec import Message

HEARTBEAT_S = 1.0
TEXT_LENGTH = 50
TEXT_SPACING_S = 0.1
MOST_WAITING_TEXTS = 30
SAME_TEXT_AGAIN_S = 5.0
"""The same text within this time is not news, and ground stations speak texts aloud."""


class Component:
    """What we send unasked, spaced out: a companion's link and an autopilot's forward buffer are small."""

    def __init__(self, telemetry_rate_Hz: float) -> None:
        self._value_period_s = 1.0 / telemetry_rate_Hz
        self._heartbeat_at = -math.inf
        self._values_at: dict[str, float] = {}
        self._texts: deque[Message] = deque(maxlen=MOST_WAITING_TEXTS)
        self._said: dict[str, float] = {}
        self._text_at = -math.inf
        self._text_id = 0

    def say(self, t: float, severity: int, text: str) -> None:
        """Queue a STATUSTEXT, in chunks where it is longer than one."""
        self._said = {said: at for said, at in self._said.items() if t - at < SAME_TEXT_AGAIN_S}
        if text in self._said:
            return
        self._said[text] = t
        data = text.replace("°", " deg").replace("…", "..").encode("ascii", "replace")
        chunks = [data[i : i + TEXT_LENGTH] for i in range(0, len(data), TEXT_LENGTH)] or [b""]
        identity = 0
        if len(chunks) > 1:
            if len(data) % TEXT_LENGTH == 0:
                chunks.append(b"")  # a message of several chunks ends with one that is not full
            self._text_id = identity = self._text_id % 0xFFFF + 1
        for number, chunk in enumerate(chunks):
            self._texts.append(mavlink.MAVLink_statustext_message(severity, chunk, identity, number))

    def due(
        self, t: float, time_boot_ms: int, values: Mapping[str, float], system_status: int
    ) -> list[Message]:
        """What is to be sent at time `t`. `values` are the named values of now; NaN is not sent."""
        messages: list[Message] = []
        if t - self._heartbeat_at >= HEARTBEAT_S - 0.001:
            self._heartbeat_at = t
            messages.append(
                mavlink.MAVLink_heartbeat_message(
                    mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, system_status, 3
                )
            )
        if self._texts and t - self._text_at >= TEXT_SPACING_S:
            self._text_at = t
            messages.append(self._texts.popleft())
        messages.extend(self._named_value(t, time_boot_ms, values))
        return messages

    def _named_value(self, t: float, time_boot_ms: int, values: Mapping[str, float]) -> Sequence[Message]:
        """The value that is most overdue, so that they spread over time by themselves."""
        spacing_s = self._value_period_s / max(1, len(values))
        if self._values_at and t - max(self._values_at.values()) < spacing_s - 0.001:
            return ()
        sent = {name: self._values_at.get(name, -math.inf) for name in values if math.isfinite(values[name])}
        name = min(sent, key=lambda name: sent[name], default=None)
        if name is None or t - sent[name] < self._value_period_s - 0.001:
            return ()
        self._values_at[name] = t
        return (mavlink.MAVLink_named_value_float_message(time_boot_ms, name.encode(), values[name]),)


def answer_timesync(message: Message, now_ns: int) -> list[Message]:
    """The reply to a TIMESYNC request of the autopilot."""
    if message.tc1 != 0:
        return []
    return [mavlink.MAVLink_timesync_message(now_ns, message.ts1)]
