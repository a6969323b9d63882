"""The messages that this package uses. Most messages of an autopilot are for others.

If your code handles one more message, add it here. A test finds forgotten ones.
"""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

CLOCK = frozenset({"ATTITUDE", "GLOBAL_POSITION_INT", "RC_CHANNELS", "SYSTEM_TIME"})
STATE = CLOCK | {"HEARTBEAT", "SCALED_PRESSURE", "STATUSTEXT"}
RADIO = frozenset({"PARAM_VALUE", "RC_CHANNELS", "STATUSTEXT", "SYS_STATUS"})
MISSION = frozenset({
    "MISSION_ACK", "MISSION_COUNT", "MISSION_CURRENT", "MISSION_ITEM", "MISSION_ITEM_INT",
    "MISSION_ITEM_REACHED", "PARAM_VALUE", "STATUSTEXT",
})  # fmt: skip
QUESTIONS = frozenset({
    "COMMAND_INT", "COMMAND_LONG", "PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET", "PING",
    "SETUP_SIGNING", "TIMESYNC",
})  # fmt: skip
COMMANDS = frozenset({"COMMAND_INT", "COMMAND_LONG"})
ANSWERS = frozenset({"COMMAND_ACK"})
OVERRIDES = frozenset({"RC_CHANNELS_OVERRIDE"})
"""Sent by ground stations."""
ALL = STATE | RADIO | MISSION | QUESTIONS | ANSWERS | OVERRIDES
NUMBERS = frozenset(number for number, kind in mavlink.mavlink_map.items() if kind.msgname in ALL)
"""The message ids of `ALL`."""
