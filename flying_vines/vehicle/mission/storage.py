"""What becomes of a mission item in an autopilot's storage: rounded, stripped or refused."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Literal

from flying_vines.vehicle.mission.item import MissionItem, is_nav

Kind = Literal["ardupilot", "px4"]

ACCEPTED, ERROR, UNSUPPORTED_FRAME, UNSUPPORTED, NO_SPACE = 0, 1, 2, 3, 4
INVALID_PARAM1, INVALID_SEQUENCE, CANCELLED = 6, 13, 15

CAPACITY = 700
MISSION_FRAME = 2

Params = tuple[float, float, float, float, float, float, float]


class MissionRefused(ValueError):
    """The autopilot does not take this item; `result` is the MAV_MISSION_RESULT."""

    def __init__(self, item: MissionItem, result: int) -> None:
        super().__init__(f"item {item.seq} (command {item.command}) refused with MAV_MISSION_RESULT {result}")
        self.result = result


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


def _f32(value: float) -> float:
    try:
        return float(struct.unpack("<f", struct.pack("<f", value))[0])
    except OverflowError:
        return math.copysign(math.inf, value)


def whole_centimetres(altitude_m: float) -> float:
    """An altitude after ArduPilot's storage, which counts centimetres in 32 bits."""
    highest = float((1 << 31) - 1)
    centimetres = int(max(-highest, min(highest, _f32(altitude_m * 100.0))))
    return _f32(centimetres * _f32(0.01))


def _none(value: float) -> float:
    return 0.0


_Cast = Callable[[float], float]

# Casts of param1..4, x, y, z; what is missing at the end is not stored.
_ARDUPILOT_DO: dict[int, tuple[_Cast, ...]] = {
    112: (_f32,),
    114: (_f32,),
    115: (_f32, _u16, _i16, _u8),
    177: (_u16, _i16),
    178: (_u8, _f32, _f32),
    179: (_u8,),
    181: (_u8, _u8),
    182: (_u8, _i16, _f32),
    183: (_u8, _u16),
    184: (_u8, _u16, _i16, _f32),
    189: (),
    193: (_u8,),
    195: (_none, _none, _none, _none, _f32, _f32, _f32),
    201: (_u16, _none, _none, _none, _f32, _f32, _f32),
    202: (_u16, _u16, _u16, _u8, _u8, _u16, _u16),
    203: (_u8, _u8, _i16, _u8, _u8, _u16),
    205: (_f32, _f32, _f32),
    206: (_f32, _none, _u8),
    207: (_u8,),
    208: (_u8,),
    211: (_u8, _u8),
    215: (_u16,),
    216: (_u8,),
    217: (_u16, _f32, _f32, _f32),
    218: (_u16, _u8),
    222: (_u16, _f32, _f32, _f32),
    531: (_u8, _f32),
    600: (_u16,),
    601: (_u16, _i16),
    1000: (_f32, _f32, _f32, _f32, _u8),
    2000: (_u8, _f32, _u16, _u16),
    2001: (_u8,),
    2500: (_u8,),
    2501: (_u8,),
    42600: (_u8, _u8, _f32, _f32),
}
_ARDUPILOT_NAV = {16, 17, 18, 19, 20, 21, 22, 82, 84, 85, 92, 93, 94, 42702}
_YAW_MAY_BE_NAN = {16, 21, 22, 84, 85}

_PX4_NAV = {16, 17, 19, 20, 21, 22, 84, 85}
_PX4_MISSION_FRAME = {
    20,
    93,
    112,
    114,
    177,
    178,
    179,
    187,
    189,
    195,
    197,
    200,
    201,
    203,
    204,
    205,
    206,
    211,
} | {530, 531, 532, 534, 1000, 1001, 2000, 2001, 2003, 2500, 2501, 3000, 42600}
# What PX4 gives back: the frames of integer coordinates.
_PX4_GLOBAL_FRAMES = {0: 5, 5: 5, 3: 6, 6: 6}


def store(kind: Kind, item: MissionItem) -> MissionItem:
    """The item as the autopilot would give it back; MissionRefused if it would not take it."""
    return _store_ardupilot(item) if kind == "ardupilot" else _store_px4(item)


def _store_ardupilot(item: MissionItem) -> MissionItem:
    if item.command not in _ARDUPILOT_DO and item.command not in _ARDUPILOT_NAV:
        raise MissionRefused(item, UNSUPPORTED)
    params = list(item.params)
    if item.command in _YAW_MAY_BE_NAN and math.isnan(params[3]):
        params[3] = 0.0
    for index, value in enumerate(params):
        if not math.isfinite(value):
            raise MissionRefused(item, INVALID_PARAM1 + index)
    if item.command == 42702:
        casts: tuple[_Cast, ...] = (_u8, _u8, _f16, _f16, _i16, _i16)
        return _stored(item, _cast(params, casts), frame=0)
    if item.command in _ARDUPILOT_DO:
        return _stored(item, _cast(params, _ARDUPILOT_DO[item.command]), frame=0)
    p1, p2, p3, p4, latitude, longitude, z = params
    # Latitude and longitude are integers of 1e-7 degrees there, which a double holds well enough.
    place = latitude, longitude, whole_centimetres(z)
    return _stored(item, (_f32(p1), _f32(p2), _f32(p3), _f32(p4), *place), frame=_ardupilot_frame(item))


def _ardupilot_frame(item: MissionItem) -> int:
    if item.command == 93:
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


def _store_px4(item: MissionItem) -> MissionItem:
    if item.frame == MISSION_FRAME:
        if item.command not in _PX4_MISSION_FRAME:
            raise MissionRefused(item, UNSUPPORTED)
        return _stored(item, item.params, MISSION_FRAME)
    if item.frame not in _PX4_GLOBAL_FRAMES:
        raise MissionRefused(item, UNSUPPORTED_FRAME)
    if item.command not in _PX4_NAV:
        takes = item.command in _PX4_MISSION_FRAME
        raise MissionRefused(item, UNSUPPORTED_FRAME if takes else UNSUPPORTED)
    return _stored(item, item.params, _PX4_GLOBAL_FRAMES[item.frame])


def is_nav_item(kind: Kind, item: MissionItem) -> bool:
    """Whether the mission waits for it; PX4 waits for CONDITION_DELAY, ArduPilot flies on."""
    return is_nav(item.command) or (kind == "px4" and item.command == 112)
