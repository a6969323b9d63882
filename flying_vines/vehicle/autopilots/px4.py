"""PX4."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.autopilots.autopilot import Autopilot
from flying_vines.vehicle.autopilots.px4_mission import Px4Watch
from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.mission.item import CONDITION_DELAY, MissionItem
from flying_vines.vehicle.mission.storage import (
    MISSION_FRAME,
    UNSUPPORTED,
    UNSUPPORTED_FRAME,
    MissionRefused,
)

MAIN_MODES = {1: "MANUAL", 2: "ALTCTL", 3: "POSCTL", 4: "AUTO", 5: "ACRO", 6: "OFFBOARD", 7: "STABILIZED"}
AUTO, AUTO_MODES = 4, {1: "READY", 2: "TAKEOFF", 3: "LOITER", 4: "MISSION", 5: "RTL", 6: "LAND"}

RECEIVER_NOT_USED = {1: "joystick only", 4: "stick input disabled"}
"""Values of COM_RC_IN_MODE with which the RC status does not cover the receiver."""
DEFAULT_LOSS_S = 0.5
STATUS_AFTER_S = 1.1
"""Maximum time from the end of COM_RC_LOSS_T to the status in SYS_STATUS. Measured: the status changes 0.8 to
1.4 s after a loss with COM_RC_LOSS_T = 0.5 s."""

_NAV = {16, 17, 19, 20, 21, 22, 84, 85}
_MISSION_FRAME = {
    *(20, 93, 112, 114, 177, 178, 179, 187, 189, 195, 197, 200, 201, 203, 204, 205, 206, 211),
    *(530, 531, 532, 534, 1000, 1001, 2000, 2001, 2003, 2500, 2501, 3000, 42600),
}
_GLOBAL_FRAMES = {0: 5, 5: 5, 3: 6, 6: 6}
"""The frames in which PX4 returns items: those with integer coordinates."""


class Px4(Autopilot):
    kind = "px4"
    title = "PX4"
    mav_autopilot = mavlink.MAV_AUTOPILOT_PX4
    rc_parameters = ("COM_RC_LOSS_T", "COM_RC_IN_MODE")
    mode_channel_parameter = "RC_MAP_FLTMODE"
    other_uses = tuple(
        f"RC_MAP_{use}_SW" for use in ("KILL", "ARM", "RETURN", "LOITER", "OFFB", "GEAR", "TRANS")
    )
    needs_rc_status = True
    mission_watch = Px4Watch
    item_commands = ("actuator", "winch", "gripper")
    item_match = ", param7 = 1"
    own_rates_Hz: ClassVar = {"MISSION_CURRENT": 1.0}
    rc_remedies: ClassVar = {"COM_RC_IN_MODE": "set COM_RC_IN_MODE = 0, so that the receiver is used"}

    def mode_name(self, custom_mode: int) -> str:
        main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
        name = MAIN_MODES.get(main, f"MODE {main}")
        return f"{name}.{AUTO_MODES.get(sub, sub)}" if main == AUTO else name

    def parameter_value(self, message: MavlinkMessage) -> float:
        """PX4 puts the bytes of an integer into the float field."""
        if message.param_type == mavlink.MAV_PARAM_TYPE_INT32:
            return float(struct.unpack("<i", struct.pack("<f", message.param_value))[0])
        return float(message.param_value)

    def hides_rc_loss(self, values: Mapping[str, float]) -> str:
        mode = int(values.get("COM_RC_IN_MODE", 0))
        return f"COM_RC_IN_MODE {mode}" if mode in RECEIVER_NOT_USED else ""

    def rc_loss_shows_within_s(self, values: Mapping[str, float]) -> float:
        return STATUS_AFTER_S + max(DEFAULT_LOSS_S, values.get("COM_RC_LOSS_T", 0.0))

    def how_to_set_stream(self, message: str, rate_Hz: int) -> str:
        if message in self.own_rates_Hz:
            return "PX4 sends it by itself once it has a mission: set a baud rate that carries all streams"
        return (
            f"put into etc/extras.txt on its card: mavlink stream -d DEVICE -s {message} -r {rate_Hz}; "
            "and set a baud rate that carries all streams"
        )

    def store(self, item: MissionItem) -> MissionItem:
        if item.frame == MISSION_FRAME:
            if item.command not in _MISSION_FRAME:
                raise MissionRefused(item, UNSUPPORTED)
            return replace(item, current=False)
        if item.frame not in _GLOBAL_FRAMES:
            raise MissionRefused(item, UNSUPPORTED_FRAME)
        if item.command not in _NAV:
            takes = item.command in _MISSION_FRAME
            raise MissionRefused(item, UNSUPPORTED_FRAME if takes else UNSUPPORTED)
        return replace(item, frame=_GLOBAL_FRAMES[item.frame], current=False)

    def waits_for(self, item: MissionItem) -> bool:
        """PX4 also waits for CONDITION_DELAY; ArduPilot flies on."""
        return super().waits_for(item) or item.command == CONDITION_DELAY
