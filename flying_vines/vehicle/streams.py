"""Requests the message streams that we need from the autopilot, and requests a missing stream again."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.mavlink.codec import MavlinkMessage

ASK_SPACING_S = 0.1
ASK_AGAIN_S = 3.0
REFUSED_S = 30.0
"""A refused stream is requested again only after this time: ArduPilot shows each refusal to the pilot.
Essential streams are requested sooner."""
ANSWER_WITHIN_S = 0.5
"""We wait this long for an answer. In this time no other stream is requested, because an answer does not name
its stream."""
MISSING_AFTER_S = 5.0
OTHERS_HZ = 5.0
SILENT_S = 2.5
"""After this time without any message the whole link is silent, and no single stream counts as missing."""
STALLED_S = 0.5
"""If two checks are this far apart, our process did not run, and messages may wait unread. The time until a
stream counts as missing starts again."""

_REFUSALS = {mavlink.MAV_RESULT_DENIED, mavlink.MAV_RESULT_UNSUPPORTED, mavlink.MAV_RESULT_FAILED}


@dataclass(slots=True)
class _Stream:
    message_id: int
    rate_Hz: float
    essential: bool
    asked_at: float | None = None
    wanted_since: float | None = None
    received_at: float | None = None
    refused_at: float = -math.inf


class Wanted(NamedTuple):
    """A requested message stream."""

    rate_Hz: float
    essential: bool
    refused: bool
    """The autopilot refused it recently."""


class Streams:
    """Watches the streams, and requests them by SET_MESSAGE_INTERVAL.

    The autopilot forgets the rates when it reboots. So a stream that stops is requested again.
    """

    def __init__(self, rc_rate_Hz: float, others: Mapping[str, int] = MappingProxyType({})) -> None:
        """`others`: names and ids of more messages, which are requested at `OTHERS_HZ`."""
        self._streams = {name: _Stream(number, OTHERS_HZ, False) for name, number in others.items()}
        self._streams |= {
            "RC_CHANNELS": _Stream(mavlink.MAVLINK_MSG_ID_RC_CHANNELS, rc_rate_Hz, False),
            "SYS_STATUS": _Stream(mavlink.MAVLINK_MSG_ID_SYS_STATUS, 10.0, True),
            "GLOBAL_POSITION_INT": _Stream(mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 5.0, True),
            "MISSION_CURRENT": _Stream(mavlink.MAVLINK_MSG_ID_MISSION_CURRENT, 5.0, False),
            "SYSTEM_TIME": _Stream(mavlink.MAVLINK_MSG_ID_SYSTEM_TIME, 1.0, False),
            "SCALED_PRESSURE": _Stream(mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE, 1.0, False),
        }
        self._essential = {name: stream for name, stream in self._streams.items() if stream.essential}
        self._asked_at = -math.inf
        self._asked: _Stream | None = None
        self._received_at = self._received_since = self._checked_at = -math.inf

    def handle(self, t: float, message: MavlinkMessage) -> None:
        """Take in a message of our autopilot."""
        if t - self._received_at > SILENT_S:
            self._received_since = t
        self._received_at = t
        kind = message.get_type()
        stream = self._streams.get(kind)
        if stream is not None:
            stream.received_at = t
        elif kind == "COMMAND_ACK" and message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            if self._awaited(t) and self._asked is not None and message.result in _REFUSALS:
                self._asked.refused_at = t
            self._asked = None

    def forget(self) -> None:
        """The autopilot rebooted, or the link is new: request all streams again, now."""
        for stream in self._streams.values():
            stream.asked_at = stream.wanted_since = stream.received_at = None
            stream.refused_at = -math.inf
        self._asked = None

    def requests(self, t: float, system_id: int) -> list[MavlinkMessage]:
        """At most one request per call. They are spaced, so that small buffers do not overflow."""
        if t - self._asked_at < ASK_SPACING_S or self._awaited(t):
            return []
        for stream in self._streams.values():
            if not stream.essential and t - stream.refused_at < REFUSED_S:
                continue
            never_asked = stream.asked_at is None
            silent = stream.received_at is None or t - stream.received_at > max(2.0, 3.0 / stream.rate_Hz)
            if never_asked or (silent and t - (stream.asked_at or 0.0) >= ASK_AGAIN_S):
                stream.asked_at = self._asked_at = t
                self._asked = stream
                stream.wanted_since = t if stream.wanted_since is None else stream.wanted_since
                return [
                    mavlink.MAVLink_command_long_message(
                        system_id, 1, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0,
                        stream.message_id, 1e6 / stream.rate_Hz, 0, 0, 0, 0, 0,
                    )
                ]  # fmt: skip
        return []

    def _awaited(self, t: float) -> bool:
        """True if the answer to the last request may still come."""
        return self._asked is not None and t - self._asked_at < ANSWER_WITHIN_S

    def wanted(self, t: float) -> dict[str, Wanted]:
        """All requested streams, by message name."""
        return {
            name: Wanted(stream.rate_Hz, stream.essential, t - stream.refused_at < REFUSED_S)
            for name, stream in self._streams.items()
        }

    def missing(self, t: float) -> list[str]:
        """The essential messages that were requested and do not arrive, although other messages do.

        Call it at each tick.
        """
        if t - self._checked_at > STALLED_S:
            self._received_since = t
        self._checked_at = t
        if t - self._received_at > SILENT_S:
            return []
        # Count from the time when all of these had been requested, so that one text names all missing ones.
        asked = max(t if s.wanted_since is None else s.wanted_since for s in self._essential.values())
        since = max(asked, self._received_since)
        return [
            name
            for name, stream in self._essential.items()
            if t - max(since, stream.received_at or -math.inf) > MISSING_AFTER_S
        ]
