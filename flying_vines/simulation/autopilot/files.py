"""MAVLink FTP of an autopilot without files. Every request is answered, so that no client waits."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

_TERMINATE, _LIST, _RESET, _ACK, _NAK = 1, 3, 2, 128, 129
_END_OF_FILE, _UNKNOWN_COMMAND, _NOT_FOUND = 6, 7, 10
_FOR_A_FILE = {4, 6, 8, 9, 10, 11, 12, 13, 14, 15}
_HEADER_BYTES, _PAYLOAD_BYTES = 12, 251


def answer(message: Any) -> Any | None:
    """The answer to a FILE_TRANSFER_PROTOCOL request; None for other messages."""
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
