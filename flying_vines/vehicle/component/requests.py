"""Requests that every component must answer: identity, messages, message rates, pings.

Acknowledgements, pings and TIMESYNC answers are addressed to the sender of the request. `vehicle/commands.py`
answers all other commands.
"""

from __future__ import annotations

import math
import re
import struct
from collections import deque
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.clock import BURST, RATE_HZ, Timesync, target_of
from flying_vines.vehicle.component.senders import Sender
from flying_vines.vehicle.component.telemetry import (
    HEARTBEAT_S,
    MAX_PERIOD_S,
    MIN_PERIOD_S,
    MUTED_S,
    Heartbeat,
    NamedValues,
)
from flying_vines.vehicle.component.transmit_queue import acknowledgement
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.notice import Notice, Severity
from flying_vines.vehicle.token_bucket import TokenBucket

ACCEPTED, DENIED, UNSUPPORTED = (
    mavlink.MAV_RESULT_ACCEPTED,
    mavlink.MAV_RESULT_DENIED,
    mavlink.MAV_RESULT_UNSUPPORTED,
)
"""DENIED: known, but not with these params. UNSUPPORTED: unknown."""

HEARTBEAT = mavlink.MAVLINK_MSG_ID_HEARTBEAT
NAMED_VALUE = mavlink.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT
INTERVAL = mavlink.MAVLINK_MSG_ID_MESSAGE_INTERVAL
AUTOPILOT_VERSION = mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
NOT_SENT_US, OFF_US, USUAL_US = 0, -1, 0
"""In MESSAGE_INTERVAL 0 means that we do not have this message, -1 that it is off. In a request 0 means the
usual rate."""

MAX_PINGS = 16

RequestOutput = MavlinkMessage | Notice
RequestOutcome = tuple[int, list[RequestOutput]]
"""MAV_RESULT, and the messages and texts that follow it."""


class Requests:
    """Answers requests by message type and command number."""

    MESSAGES = frozenset(
        (
            mavlink.MAVLINK_MSG_ID_COMMAND_LONG,
            mavlink.MAVLINK_MSG_ID_COMMAND_INT,
            mavlink.MAVLINK_MSG_ID_PING,
            mavlink.MAVLINK_MSG_ID_TIMESYNC,
        )
    )
    """The messages that `handle` takes."""

    def __init__(self, component_id: int, heartbeat: Heartbeat, values: NamedValues) -> None:
        self._component_id = component_id
        self._heartbeat = heartbeat
        self._values = values
        self._pinged: deque[tuple[object, object]] = deque(maxlen=MAX_PINGS)
        self._clock_answers = TokenBucket(0.0, BURST, RATE_HZ)
        self._commands: dict[int, Callable[[float, MavlinkMessage, Sender], RequestOutcome]] = {
            mavlink.MAV_CMD_REQUEST_MESSAGE: self._request,
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
            mavlink.MAV_CMD_GET_MESSAGE_INTERVAL: self._get_interval,
            mavlink.MAV_CMD_REQUEST_PROTOCOL_VERSION: self._protocol_version,
            mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: self._capabilities,
        }

    def handle(
        self, t: float, message: MavlinkMessage, system_id: int, sender: Sender
    ) -> list[RequestOutput] | None:
        """The acknowledgement and then the requested messages. None: the message is not ours to answer.

        Args:
            t: now, in seconds.
            message: one of `MESSAGES`.
            system_id: the system id of our vehicle.
            sender: the sender of the message.
        """
        kind = message.get_type()
        if kind == "PING":
            return self._ping(message, system_id)
        if kind == "TIMESYNC":
            return self._timesync(t, message, system_id)
        target = (message.target_system, message.target_component)
        if target != (system_id, self._component_id) or message.command not in self._commands:
            return None
        result, answers = self._commands[message.command](t, message, sender)
        return [acknowledgement(message, result), *answers]

    def _request(self, t: float, message: MavlinkMessage, sender: Sender) -> RequestOutcome:
        wanted = _whole(message.param1)
        if wanted is None:
            return DENIED, []
        if wanted == INTERVAL:
            return self._interval_of(t, _whole(message.param2))
        if wanted == AUTOPILOT_VERSION:
            return ACCEPTED, [autopilot_version()]
        if wanted == ProtocolVersion.id:
            return ACCEPTED, [ProtocolVersion()]
        if wanted == HEARTBEAT:
            self._heartbeat.now()
            return ACCEPTED, []
        if wanted == NAMED_VALUE:
            self._values.request_once(t)
            return ACCEPTED, []
        return UNSUPPORTED, []

    def _set_interval(self, t: float, message: MavlinkMessage, sender: Sender) -> RequestOutcome:
        wanted, interval_us = _whole(message.param1), message.param2
        if wanted is None:
            return DENIED, []
        if wanted == HEARTBEAT:
            unchanged = interval_us in (USUAL_US, HEARTBEAT_S * 1e6)
            return (ACCEPTED if unchanged else DENIED), []
        if wanted != NAMED_VALUE:
            return UNSUPPORTED, []
        if sender.refusal:
            text = f"Vine: rate of values unchanged: {sender.refusal}"
            return DENIED, [Notice(t, Severity.WARNING, text, source=sender.name)]
        period_s = math.inf if interval_us == OFF_US else interval_us / 1e6
        if interval_us == USUAL_US:
            self._values.request_period(t, None)
        elif interval_us == OFF_US or MIN_PERIOD_S <= period_s <= MAX_PERIOD_S:
            if self._values.request_period(t, period_s):
                off = "switched the values off"
                what = off if period_s == math.inf else f"slowed the values to one in {period_s:g} s"
                text = f"Vine: {sender.name} {what}, for {MUTED_S:.0f} s"
                return ACCEPTED, [Notice(t, Severity.NOTICE, text, source=sender.name)]
        else:
            return DENIED, []
        return ACCEPTED, []

    def _get_interval(self, t: float, message: MavlinkMessage, sender: Sender) -> RequestOutcome:
        return self._interval_of(t, _whole(message.param1))

    def _interval_of(self, t: float, wanted: int | None) -> RequestOutcome:
        if wanted is None or not 0 <= wanted <= 0xFFFF:
            return DENIED, []
        interval_us = NOT_SENT_US
        if wanted == HEARTBEAT:
            interval_us = int(HEARTBEAT_S * 1e6)
        elif wanted == NAMED_VALUE:
            period_s = self._values.period_s(t)
            interval_us = OFF_US if period_s == math.inf else round(period_s * 1e6)
        return ACCEPTED, [mavlink.MAVLink_message_interval_message(wanted, interval_us)]

    def _protocol_version(self, t: float, message: MavlinkMessage, sender: Sender) -> RequestOutcome:
        return (ACCEPTED, [ProtocolVersion()]) if message.param1 == 1 else (DENIED, [])

    def _capabilities(self, t: float, message: MavlinkMessage, sender: Sender) -> RequestOutcome:
        return (ACCEPTED, [autopilot_version()]) if message.param1 == 1 else (DENIED, [])

    def _ping(self, message: MavlinkMessage, system_id: int) -> list[MavlinkMessage]:
        """Answer a ping to us or to all, but only once. Otherwise two components could ping without end."""
        sender = (message.get_srcSystem(), message.get_srcComponent())
        ping = (message.time_usec, message.seq)
        target = (message.target_system, message.target_component)
        to_us = target in ((0, 0), (system_id, 0), (system_id, self._component_id))
        ours = sender == (system_id, self._component_id)
        if not to_us or ours or (sender, ping) in self._pinged:
            return []
        self._pinged.append((sender, ping))
        return [mavlink.MAVLink_ping_message(*ping, *sender)]

    def _timesync(self, t: float, message: MavlinkMessage, system_id: int) -> list[MavlinkMessage]:
        """Answer a request of the autopilot for our clock. TIMESYNC answers (`tc1` not 0) get no answer."""
        asker = (message.get_srcSystem(), message.get_srcComponent())
        autopilot = (system_id, mavlink.MAV_COMP_ID_AUTOPILOT1)
        to_us = target_of(message) in ((0, 0), (system_id, 0), (system_id, self._component_id))
        if asker != autopilot or message.tc1 != 0 or not to_us or not self._clock_answers.take(t):
            return []
        return [Timesync(int(t * 1e9), message.ts1, *asker)]


def _whole(number: float) -> int | None:
    """A float as a message id; None if it is not a whole number."""
    return int(number) if math.isfinite(number) and number == int(number) else None


CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
)
"""MAVLink has two encodings of parameters, and we must claim one. Our parameters are floats, for which both
encodings are equal."""

_STAGES = {"a": 64, "b": 128, "rc": 192}
_DEVELOPMENT, _RELEASE = 0, 255
"""FIRMWARE_VERSION_TYPE, the lowest byte of a version."""


def packed_version(text: str) -> int:
    """A version such as 1.2.3 or 1.2.3rc1 in MAVLink's form: one byte each, then FIRMWARE_VERSION_TYPE."""
    found = re.match(r"(\d+)\.(\d+)(?:\.(\d+))?(a|b|rc)?", text)
    if found is None:
        return 0
    major, minor, patch = (min(int(part or 0), 255) for part in found.groups()[:3])
    stage = _STAGES.get(found[4], _RELEASE)
    if ".dev" in text or "+" in text:
        stage = _DEVELOPMENT
    return major << 24 | minor << 16 | patch << 8 | stage


def autopilot_version() -> MavlinkMessage:
    """Our version and capabilities. The hardware id is empty: the autopilot sends that of the vehicle."""
    try:
        ours = packed_version(version("flying-vines"))
    except PackageNotFoundError:
        ours = 0
    none = bytes(8)
    return mavlink.MAVLink_autopilot_version_message(CAPABILITIES, ours, 0, 0, 0, none, none, none, 0, 0, 0)


class ProtocolVersion(mavlink.MAVLink_message):  # type: ignore[misc]
    """PROTOCOL_VERSION, which the dialect lacks: we send MAVLink 2 and also read MAVLink 1."""

    id = 300
    msgname = "PROTOCOL_VERSION"
    crc_extra = 217

    def __init__(self) -> None:
        super().__init__(self.id, self.msgname)

    def pack(self, mav: MavlinkMessage, force_mavlink1: bool = False) -> bytes:
        spec_hash = library_hash = bytes(8)
        payload = struct.pack("<HHH8s8s", 200, 100, 200, spec_hash, library_hash)
        frame: bytes = self._pack(mav, self.crc_extra, payload, force_mavlink1=force_mavlink1)
        return frame
