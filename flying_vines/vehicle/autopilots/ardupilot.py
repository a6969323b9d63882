"""ArduPilot."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from typing import ClassVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.autopilots.ardupilot_mission import ArduPilotWatch
from flying_vines.vehicle.autopilots.autopilot import LOSS_SHOWN_WITHIN_S, Autopilot
from flying_vines.vehicle.mission.item import NAV_SCRIPT_TIME, MissionItem
from flying_vines.vehicle.mission.storage import (
    INVALID_PARAM1,
    UNSUPPORTED,
    UNSUPPORTED_FRAME,
    MissionRefused,
    Params,
    f32,
)

COPTER_MODES = {
    0: "STABILIZE", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 5: "LOITER", 6: "RTL", 9: "LAND",
    16: "POSHOLD", 17: "BRAKE", 21: "SMART_RTL", 27: "AUTO RTL",
}  # fmt: skip

IGNORE_RECEIVER, IGNORE_OVERRIDES, IGNORE_FAILSAFE_FLAG = 1, 2, 4
"""Bits of RC_OPTIONS."""
DEFAULT_OVERRIDE_S = 3.0

STREAM_GROUPS = {
    "SYS_STATUS": "EXT_STAT",
    "MISSION_CURRENT": "EXT_STAT",
    "GLOBAL_POSITION_INT": "POSITION",
    "RC_CHANNELS": "RC_CHAN",
    "SYSTEM_TIME": "EXTRA3",
    "SCALED_PRESSURE": "RAW_SENS",
}
"""The stream group of each message: a part of the name of the parameter for its rate."""


class ArduPilot(Autopilot):
    kind = "ardupilot"
    title = "ArduPilot"
    mav_autopilot = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    rc_parameters = ("FS_THR_ENABLE", "RC_FS_TIMEOUT", "RC_OPTIONS", "RC_OVERRIDE_TIME")
    mode_channel_parameter = "FLTMODE_CH"
    other_uses = ("RC{}_OPTION",)
    mission_watch = ArduPilotWatch
    begins_with_home = True
    item_commands = ("script_message", "winch", "gripper")
    gives_items_in_any_order = True
    hides_our_parameters = True
    rc_remedies: ClassVar = {
        "FS_THR_ENABLE": "set FS_THR_ENABLE = 1",
        "RC_FS_TIMEOUT": "set RC_FS_TIMEOUT = 1",
        "RC_OPTIONS": "clear bits 0 and 2 of RC_OPTIONS: they ignore the receiver, or its failsafe flag",
    }
    unseen_loss_remedy = (
        "if you switched off this vehicle's transmitter: set FS_THR_ENABLE = 1, and the receiver's failsafe"
        " to no pulses, or to a throttle below FS_THR_VALUE"
    )

    def mode_name(self, custom_mode: int) -> str:
        return COPTER_MODES.get(custom_mode, f"MODE {custom_mode}")

    def hides_rc_loss(self, values: Mapping[str, float]) -> str:
        if values.get("FS_THR_ENABLE") == 0:
            return "FS_THR_ENABLE 0"
        if values.get("RC_FS_TIMEOUT", 0.0) > LOSS_SHOWN_WITHIN_S:
            return f"RC_FS_TIMEOUT {values['RC_FS_TIMEOUT']:g}"
        options = int(values.get("RC_OPTIONS", 0))
        return f"RC_OPTIONS {options}" if options & (IGNORE_RECEIVER | IGNORE_FAILSAFE_FLAG) else ""

    def override_lasts_s(self, values: Mapping[str, float]) -> float:
        if int(values.get("RC_OPTIONS", 0)) & IGNORE_OVERRIDES:
            return 0.0
        lasts_s = values.get("RC_OVERRIDE_TIME", DEFAULT_OVERRIDE_S)
        return math.inf if lasts_s < 0.0 else lasts_s

    def how_to_set_stream(self, message: str, rate_Hz: int) -> str:
        group = STREAM_GROUPS.get(message)
        if group is None:
            return super().how_to_set_stream(message, rate_Hz)
        return (
            f"set SRn_{group} = {rate_Hz} (n is the number of the MAVLink port, USB = 0; from 4.7 on "
            f"MAVn_{group}, USB = 1), and a baud rate that carries all streams"
        )

    def store(self, item: MissionItem) -> MissionItem:
        if item.command not in _DO and item.command not in _NAV:
            raise MissionRefused(item, UNSUPPORTED)
        params = list(item.params)
        if item.command in _YAW_MAY_BE_NAN and math.isnan(params[3]):
            params[3] = 0.0
        for index, value in enumerate(params):
            if not math.isfinite(value):
                raise MissionRefused(item, INVALID_PARAM1 + index)
        if item.command == NAV_SCRIPT_TIME:
            return _stored(item, _cast(params, (_u8, _u8, _f16, _f16, _i16, _i16)), frame=0)
        if item.command in _DO:
            return _stored(item, _cast(params, _DO[item.command]), frame=0)
        p1, p2, p3, p4, latitude, longitude, z = params
        # ArduPilot stores latitude and longitude as integers of 1e-7 degrees; a double is precise enough.
        place = latitude, longitude, whole_centimetres(z)
        return _stored(item, (f32(p1), f32(p2), f32(p3), f32(p4), *place), frame=_frame(item))


# Each function returns a number as ArduPilot stores it.


def _u8(value: float) -> float:
    return float(int(value) & 0xFF)


def _u16(value: float) -> float:
    return float(int(value) & 0xFFFF)


def _i16(value: float) -> float:
    return float((int(value) + 0x8000 & 0xFFFF) - 0x8000)


def _f16(value: float) -> float:
    try:
        return float(struct.unpack("<e", struct.pack("<e", value))[0])
    except OverflowError:
        return math.copysign(math.inf, value)


def whole_centimetres(altitude_m: float) -> float:
    """An altitude as ArduPilot stores it: in centimetres, with 32 bits."""
    max_cm = float((1 << 31) - 1)
    centimetres = int(max(-max_cm, min(max_cm, f32(altitude_m * 100.0))))
    return f32(centimetres * f32(0.01))


def _none(value: float) -> float:
    return 0.0


_Cast = Callable[[float], float]

# Casts of param1..4, x, y, z, by command. Values after the last cast are not stored.
_DO: dict[int, tuple[_Cast, ...]] = {
    112: (f32,),
    114: (f32,),
    115: (f32, _u16, _i16, _u8),
    177: (_u16, _i16),
    178: (_u8, f32, f32),
    179: (_u8,),
    181: (_u8, _u8),
    182: (_u8, _i16, f32),
    183: (_u8, _u16),
    184: (_u8, _u16, _i16, f32),
    189: (),
    193: (_u8,),
    195: (_none, _none, _none, _none, f32, f32, f32),
    201: (_u16, _none, _none, _none, f32, f32, f32),
    202: (_u16, _u16, _u16, _u8, _u8, _u16, _u16),
    203: (_u8, _u8, _i16, _u8, _u8, _u16),
    205: (f32, f32, f32),
    206: (f32, _none, _u8),
    207: (_u8,),
    208: (_u8,),
    211: (_u8, _u8),
    215: (_u16,),
    216: (_u8,),
    217: (_u16, f32, f32, f32),
    218: (_u16, _u8),
    222: (_u16, f32, f32, f32),
    531: (_u8, f32),
    600: (_u16,),
    601: (_u16, _i16),
    1000: (f32, f32, f32, f32, _u8),
    2000: (_u8, f32, _u16, _u16),
    2001: (_u8,),
    2500: (_u8,),
    2501: (_u8,),
    42600: (_u8, _u8, f32, f32),
}
_NAV = {16, 17, 18, 19, 20, 21, 22, 82, 84, 85, 92, 93, 94, NAV_SCRIPT_TIME}
_YAW_MAY_BE_NAN = {16, 21, 22, 84, 85}
_NAV_DELAY = 93


def _frame(item: MissionItem) -> int:
    if item.command == _NAV_DELAY:
        return 0
    frame = {5: 0, 6: 3, 11: 10}.get(item.frame, item.frame)
    if frame not in (0, 2, 3, 10):
        raise MissionRefused(item, UNSUPPORTED_FRAME)
    return frame


def _cast(params: list[float], casts: tuple[_Cast, ...]) -> Params:
    out = [cast(value) for cast, value in zip(casts, params, strict=False)]
    out += [0.0] * (7 - len(out))
    return out[0], out[1], out[2], out[3], out[4], out[5], out[6]


def _stored(item: MissionItem, params: Params, frame: int) -> MissionItem:
    return MissionItem(item.seq, item.command, params, frame, False, item.autocontinue)
