"""Decodes frame payloads to message objects of the dialect: the same result as pymavlink's, but faster.

The layout of arrays, texts and fields is computed once for each message type, not for each frame.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import accumulate
from operator import itemgetter
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.mavlink.frames import Frame

MavlinkMessage = Any
"""A message object of the pymavlink dialect, or `HeaderOnly`. pymavlink has no type annotations."""

_NAMES: dict[int, str] = {number: kind.msgname for number, kind in mavlink.mavlink_map.items()}


class _Layout:
    """Converts the payloads of one message type to its fields."""

    def __init__(self, kind: Any) -> None:
        self.build: Callable[..., MavlinkMessage] = kind
        self.unpack: Callable[[bytes], tuple[Any, ...]] = kind.unpacker.unpack
        self.size: int = kind.unpacker.size
        plain = "s" not in kind.unpacker.format and set(kind.lengths) == {1} and len(kind.orders) > 1
        self.arrange = itemgetter(*kind.orders) if plain else _arrange_arrays_and_texts(kind)


def _arrange_arrays_and_texts(kind: Any) -> Callable[[tuple[Any, ...]], list[Any]]:
    begins = list(accumulate(kind.lengths, initial=0))
    places = [(begins[wire], kind.lengths[wire]) for wire in kind.orders]

    def arrange(values: tuple[Any, ...]) -> list[Any]:
        fields: list[Any] = []
        for begin, length in places:
            value = values[begin]
            if isinstance(value, bytes):
                fields.append(value.rstrip(b"\0"))
            else:
                fields.append(value if length == 1 else list(values[begin : begin + length]))
        return fields

    return arrange


_LAYOUTS = {number: _Layout(kind) for number, kind in mavlink.mavlink_map.items()}


class HeaderOnly:
    """A message whose fields nobody reads. Its methods are named as pymavlink's; it has no fields."""

    __slots__ = ("_frame",)

    def __init__(self, frame: Frame) -> None:
        """`frame`: the dialect must have its message type."""
        self._frame = frame

    def get_type(self) -> str:
        return _NAMES[self._frame.message_id]

    def get_msgId(self) -> int:
        return self._frame.message_id

    def get_srcSystem(self) -> int:
        return self._frame.system

    def get_srcComponent(self) -> int:
        return self._frame.component

    def get_seq(self) -> int:
        return self._frame.sequence

    def get_msgbuf(self) -> bytes:
        return self._frame.raw


def message_of(frame: Frame) -> MavlinkMessage:
    """The message in a frame. The dialect must have its message type."""
    layout = _LAYOUTS[frame.message_id]
    # MAVLink 2 cuts trailing zeros off. A newer dialect may have appended fields.
    payload = frame.payload.ljust(layout.size, b"\0")[: layout.size]
    message = layout.build(*layout.arrange(layout.unpack(payload)))
    header = message._header
    header.incompat_flags, header.compat_flags = frame.flags, frame.other_flags
    header.mlen, header.seq = len(frame.payload), frame.sequence
    header.srcSystem, header.srcComponent = frame.system, frame.component
    message._crc, message._payload, message._msgbuf = frame.checksum, frame.payload, frame.raw
    return message
