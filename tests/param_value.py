"""A PARAM_VALUE as a decoder returns it, with its name as text."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.mavlink.codec import MavlinkMessage


def param_value(name: str, number: float, kind: int = mavlink.MAV_PARAM_TYPE_REAL32) -> MavlinkMessage:
    message = mavlink.MAVLink_param_value_message(name.encode(), number, kind, 1, 65535)
    (decoded,) = mavlink.MAVLink(None).parse_buffer(message.pack(mavlink.MAVLink(None, 1, 1)))
    return decoded
