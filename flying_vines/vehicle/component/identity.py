"""Our answers about ourselves: AUTOPILOT_VERSION and PROTOCOL_VERSION."""

from __future__ import annotations

import re
import struct
from importlib.metadata import PackageNotFoundError, version

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.mavlink.codec import MavlinkMessage

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
