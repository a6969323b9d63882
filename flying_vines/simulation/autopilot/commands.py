"""Command numbers, and the commands that the autopilot carries out itself."""

from __future__ import annotations

import math
from typing import Any

from flying_vines.simulation.autopilot.modes import FlightMode, mode_numbered
from flying_vines.simulation.autopilot.telemetry import (
    ATTITUDE,
    GLOBAL_POSITION_INT,
    MISSION_CURRENT,
    RC_CHANNELS,
    SYS_STATUS,
    SYSTEM_TIME,
    VFR_HUD,
)
from flying_vines.vehicle.mission.storage import AutopilotKind

ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4

SET_MODE, SET_CURRENT, REBOOT, START_MISSION, ARM = 176, 224, 246, 300, 400
GET_HOME, REQUEST_CAPABILITIES = 410, 520
GET_MESSAGE_INTERVAL, SET_MESSAGE_INTERVAL, REQUEST_MESSAGE = 510, 511, 512

# Payload commands that the autopilot carries out itself: servos, relays, grippers, cameras.
PAYLOAD: dict[AutopilotKind, frozenset[int]] = {
    "ardupilot": frozenset({178, 181, 182, 183, 184, 203, 206, 211, 218, 42600}),
    "px4": frozenset({178, 187, 203, 206, 211, 2000, 2001, 2003}),
}

_CUSTOM_MODE_FLAG = 1

# Groups of REQUEST_DATA_STREAM; 0 means all.
_GROUPS: dict[int, tuple[int, ...]] = {
    2: (SYS_STATUS, MISSION_CURRENT),
    3: (RC_CHANNELS,),
    6: (GLOBAL_POSITION_INT,),
    10: (ATTITUDE,),
    11: (VFR_HUD,),
    12: (SYSTEM_TIME,),
}


def stream_group(group: int) -> tuple[int, ...]:
    """The messages of one group of REQUEST_DATA_STREAM."""
    if group == 0:
        return tuple(message_id for ids in _GROUPS.values() for message_id in ids)
    return _GROUPS.get(group, ())


def whole(value: float, default: int = -1) -> int:
    """The whole number in a command's parameter; `default` for NaN and infinities."""
    return int(value) if math.isfinite(value) else default


def parameters(message: Any) -> tuple[float, ...]:
    """param1…param7 of a COMMAND_LONG or COMMAND_INT."""
    first = message.param1, message.param2, message.param3, message.param4
    if message.get_type() == "COMMAND_INT":
        return (*first, float(message.x), float(message.y), message.z)
    return (*first, message.param5, message.param6, message.param7)


def requested_mode(kind: AutopilotKind, params: tuple[float, ...]) -> FlightMode | None:
    """The mode that DO_SET_MODE requests; None if it does not exist."""
    if not whole(params[0], 0) & _CUSTOM_MODE_FLAG:
        return None
    if kind == "ardupilot":
        return mode_numbered(kind, whole(params[1]))
    return mode_numbered(kind, whole(params[1], 0) << 16 | whole(params[2], 0) << 24)
