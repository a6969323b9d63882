"""A small set of parameters, in the encoding of the autopilot's kind, and no files.

Ground stations first request the parameters as a file, by MAVLink FTP.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.simulation.autopilot.scheduler import ScheduledCallback, Scheduler
from flying_vines.vehicle.mission.item import AutopilotKind

_HASH_CHECK = "_HASH_CHECK"
_NO_INDEX = 65535

_INT8, _INT16, _UINT32, _INT32, _REAL32 = 2, 4, 5, 6, 9
_PACE_S = 0.01

_TABLES: dict[AutopilotKind, dict[str, tuple[int, float]]] = {
    "ardupilot": {
        "SYSID_THISMAV": (_INT16, 0.0),
        "SYSID_MYGCS": (_INT16, 255.0),
        "SERIAL1_PROTOCOL": (_INT8, 2.0),
        "SERIAL1_BAUD": (_INT32, 57.0),
        "SERIAL2_PROTOCOL": (_INT8, 2.0),
        "SERIAL2_BAUD": (_INT32, 57.0),
        "SCR_ENABLE": (_INT8, 0.0),
        "CAM1_TYPE": (_INT8, 0.0),
        "FS_THR_ENABLE": (_INT8, 1.0),
        "RC_FS_TIMEOUT": (_REAL32, 1.0),
        "RC_OPTIONS": (_INT32, 32.0),
        "RC_OVERRIDE_TIME": (_REAL32, 3.0),
        "MIS_TOTAL": (_INT16, 0.0),
        "STAT_BOOTCNT": (_INT16, 1.0),
        "STAT_RUNTIME": (_INT32, 0.0),
    },
    "px4": {
        "COM_RC_IN_MODE": (_INT32, 0.0),
        "COM_RC_LOSS_T": (_REAL32, 0.5),
        "MAV_0_FORWARD": (_INT32, 1.0),
        "MAV_1_CONFIG": (_INT32, 102.0),
        "MAV_1_FORWARD": (_INT32, 1.0),
        "MAV_1_MODE": (_INT32, 2.0),
        "MAV_SYS_ID": (_INT32, 0.0),
        "MIS_COMMAND_TOUT": (_REAL32, 0.0),
        "NAV_RCL_ACT": (_INT32, 2.0),
        "SYS_AUTOSTART": (_INT32, 4001.0),
    },
}
"""Types and factory values by name."""
_READ_ONLY = {"SYSID_THISMAV", "MAV_SYS_ID", "MIS_TOTAL", "STAT_BOOTCNT", "STAT_RUNTIME"}
"""Only the autopilot changes these. The answer to PARAM_SET is their old value."""


class _RawValue(mavlink.MAVLink_param_value_message):  # type: ignore[misc]
    """PARAM_VALUE with four given bytes as value, because a float would change bytes that look like a NaN."""

    def __init__(self, name: str, raw: bytes, kind: int, count: int, index: int) -> None:
        super().__init__(name.encode(), struct.unpack("<f", raw)[0], kind, count, index)
        self._raw = raw

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        rest = struct.pack(
            "<HH16sB", self.param_count, self.param_index, self.param_id.encode(), self.param_type
        )
        return bytes(self._pack(mav, self.crc_extra, self._raw + rest, force_mavlink1=force_mavlink1))


def _first_four_bytes(message: Any) -> bytes:
    """The value's bytes as sent, padded: MAVLink 2 omits zeros at the end of a payload."""
    frame = bytes(message.get_msgbuf())
    header = 10 if frame[0] == mavlink.PROTOCOL_MARKER_V2 else 6
    return frame[header : header + min(4, frame[1])].ljust(4, b"\0")


class ParameterServer:
    """The vehicle side of the parameter protocol.

    ArduPilot sends integers as float numbers (C cast), PX4 as their bytes. For an unknown name ArduPilot does
    not answer, and PX4 sends a status text. Changes are sent to all links.
    """

    def __init__(
        self,
        kind: AutopilotKind,
        values: Mapping[str, float],
        scheduler: Scheduler,
        send: Callable[[str, Any], None],
        tell: Callable[[Any], None],
        say: Callable[[str], None],
    ) -> None:
        """`values` replace factory values; `send` sends to one link, `tell` and `say` (a text) to all."""
        self._kind = kind
        table = _TABLES[kind]
        self._types = {name: type_ for name, (type_, _) in table.items()}
        self._values = {name: float(values.get(name, factory)) for name, (_, factory) in table.items()}
        self._names = list(table)
        self._scheduler = scheduler
        self._send = send
        self._tell = tell
        self._say = say
        self._lists: dict[str, ScheduledCallback] = {}

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def change(self, name: str, value: float) -> None:
        """Change a value and send it to all links."""
        if name not in self._values:
            raise ValueError(f"the simulated {self._kind} has no parameter {name}")
        self._values[name] = value
        self._tell(self._message(name, _NO_INDEX))

    def reboot(self) -> None:
        """Values survive; running list transfers end."""
        self._lists.clear()
        if self._kind == "ardupilot":
            self._values["STAT_BOOTCNT"] += 1

    def handle(self, link: str, message: Any) -> None:
        """A message of the parameter protocol for the autopilot."""
        match message.get_type():
            case "PARAM_REQUEST_LIST":
                self._begin(link)
            case "PARAM_REQUEST_READ":
                self._read(link, message)
            case "PARAM_SET":
                self._set(link, message)

    def _begin(self, link: str) -> None:
        self._stop(link)
        if self._kind == "px4":
            self._send(link, self._hash())
        self._continue_list(link, 0)

    def _continue_list(self, link: str, index: int) -> None:
        self._lists[link] = self._scheduler.after(_PACE_S, partial(self._send_listed, link, index))

    def _send_listed(self, link: str, index: int) -> None:
        self._send(link, self._message(self._names[index], index))
        if index + 1 < len(self._names):
            self._continue_list(link, index + 1)
        else:
            del self._lists[link]

    def _stop(self, link: str) -> None:
        running = self._lists.pop(link, None)
        if running is not None:
            running.cancel()

    def _read(self, link: str, message: Any) -> None:
        name = message.param_id
        if message.param_index >= 0:
            if message.param_index < len(self._names):
                name = self._names[message.param_index]
                self._send(link, self._message(name, message.param_index))
        elif name == _HASH_CHECK and self._kind == "px4":
            self._send(link, self._hash())
        elif name in self._values:
            self._send(link, self._message(name, self._names.index(name)))
        else:
            self._unknown(name)

    def _set(self, link: str, message: Any) -> None:
        name = message.param_id
        if name == _HASH_CHECK and self._kind == "px4":
            self._stop(link)  # the ground station has these parameters in its cache
            return
        if name not in self._values:
            self._unknown(name)
            return
        value = self._sent(message)
        if math.isfinite(value) and name not in _READ_ONLY:
            self._values[name] = value
        self._tell(self._message(name, _NO_INDEX if self._kind == "ardupilot" else self._names.index(name)))

    def _sent(self, message: Any) -> float:
        value = float(message.param_value)
        if self._types[message.param_id] == _REAL32:
            return value
        if self._kind == "px4":
            return float(struct.unpack("<i", _first_four_bytes(message))[0])
        return float(int(value)) if math.isfinite(value) else value

    def _unknown(self, name: str) -> None:
        if self._kind == "px4":
            self._say(f"[pm] unknown param: {name}"[:50])

    def _message(self, name: str, index: int) -> Any:
        kind, value = self._types[name], self._values[name]
        if self._kind == "px4" and kind != _REAL32:
            return _RawValue(name, self._bytes(name), kind, len(self._names), index)
        return mavlink.MAVLink_param_value_message(name.encode(), value, kind, len(self._names), index)

    def _bytes(self, name: str) -> bytes:
        if self._types[name] == _REAL32:
            return struct.pack("<f", self._values[name])
        return struct.pack("<i", int(self._values[name]))

    def _hash(self) -> Any:
        """Checksum of names and values; a ground station compares it with its cache."""
        crc = 0xFFFFFFFF
        for name in sorted(self._names):
            crc = zlib.crc32(self._bytes(name), zlib.crc32(name.encode(), crc))
        raw = (crc ^ 0xFFFFFFFF).to_bytes(4, "little")
        return _RawValue(_HASH_CHECK, raw, _UINT32, len(self._names), _NO_INDEX)


_TERMINATE, _LIST, _RESET, _ACK, _NAK = 1, 3, 2, 128, 129
_END_OF_FILE, _UNKNOWN_COMMAND, _NOT_FOUND = 6, 7, 10
_FOR_A_FILE = {4, 6, 8, 9, 10, 11, 12, 13, 14, 15}
_HEADER_BYTES, _PAYLOAD_BYTES = 12, 251


def answer_file_request(message: Any) -> Any | None:
    """The answer of an autopilot without files to a FILE_TRANSFER_PROTOCOL request; None for other messages.

    Every request is answered, so that no client waits.
    """
    request = bytes(message.payload)
    operation = request[3]
    if operation in (0, _ACK, _NAK):
        return None
    if operation in (_TERMINATE, _RESET):
        result, data = _ACK, b""
    else:
        result = _NAK
        if operation == _LIST:
            data = bytes([_END_OF_FILE])
        else:
            data = bytes([_NOT_FOUND if operation in _FOR_A_FILE else _UNKNOWN_COMMAND])
    sequence = (int.from_bytes(request[:2], "little") + 1) % 65536
    head = sequence.to_bytes(2, "little") + bytes([request[2], result, len(data), operation, 0, 0])
    payload = (head.ljust(_HEADER_BYTES, b"\0") + data).ljust(_PAYLOAD_BYTES, b"\0")
    return mavlink.MAVLink_file_transfer_protocol_message(
        0, message.get_srcSystem(), message.get_srcComponent(), payload
    )
