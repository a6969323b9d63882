"""Bytes to MAVLink messages and back, without input or output (pymavlink as codec only)."""

from __future__ import annotations

from collections import deque
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

Message = Any
"""A message object of the pymavlink dialect; pymavlink carries no types."""

REMEMBERED_FRAMES = 32
"""Frames kept per sender to recognise copies: far fewer than the 256 after which the sequence repeats."""

LARGEST_PARSER_BACKLOG = 4096
"""No MAVLink frame is longer than 280 bytes, so a parser that holds more than this is stuck."""


class Codec:
    """Decodes a byte stream, and encodes messages as one component of one system.

    Frames that arrive twice (the same sequence number and checksum from the same sender, as routers and
    retries make them) come out once. Nothing that arrives raises.
    """

    def __init__(self, system_id: int, component_id: int) -> None:
        self.bad_frames = 0
        self.lost_frames = 0
        self.repeated_frames = 0
        self._recent: dict[tuple[int, int], deque[tuple[int, int, int]]] = {}
        self._last_sequence: dict[tuple[int, int], int] = {}
        self._mav = self._fresh_parser()
        self._out = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)

    @staticmethod
    def _fresh_parser() -> Any:
        mav = mavlink.MAVLink(None)
        mav.robust_parsing = True
        return mav

    def decode(self, data: bytes) -> list[Message]:
        """The messages that `data` completes, in order; known types with a good checksum only."""
        try:
            parsed = self._mav.parse_buffer(data) or []
        except Exception:  # pymavlink raises several unrelated types on hostile lengths
            self.bad_frames += 1
            self._mav = self._fresh_parser()
            return []
        # pymavlink gives its buffer free only when a chunk happens to end with a frame.
        del self._mav.buf[: self._mav.buf_index]
        self._mav.buf_index = 0
        if len(self._mav.buf) > LARGEST_PARSER_BACKLOG:
            self._mav = self._fresh_parser()
        messages = []
        for message in parsed:
            if message.get_type() == "BAD_DATA":
                self.bad_frames += 1
            elif message.get_msgId() < 0:
                self._pass_over(message.get_msgbuf())
            elif self._is_new(message):
                messages.append(message)
        return messages

    def _is_new(self, message: Message) -> bool:
        sender = (message.get_srcSystem(), message.get_srcComponent())
        sequence = message.get_seq()
        identity = (sequence, message.get_msgId(), message.get_crc())
        recent = self._recent.setdefault(sender, deque(maxlen=REMEMBERED_FRAMES))
        behind = (self._last_sequence.get(sender, sequence) - sequence) & 0xFF
        # Of a sender that is forwarded in part the sequence comes round soon; no copy is ahead of its frame.
        if behind < 128 and identity in recent:
            self.repeated_frames += 1
            return False
        recent.append(identity)
        self._count_lost(sender, sequence)
        return True

    def _pass_over(self, frame: bytes) -> None:
        """A frame that the dialect does not know is not lost; but nothing else in it was checked."""
        version_2 = frame[0] == mavlink.PROTOCOL_MARKER_V2
        sequence, system, component = frame[4:7] if version_2 else frame[2:5]
        if (system, component) in self._last_sequence:
            self._count_lost((system, component), sequence)

    def _count_lost(self, sender: tuple[int, int], sequence: int) -> None:
        ahead = (sequence - self._last_sequence.get(sender, sequence - 1)) & 0xFF
        if 256 - ahead <= REMEMBERED_FRAMES:
            self.lost_frames = max(0, self.lost_frames - 1)  # it was only late
            return
        self.lost_frames += max(0, ahead - 1)
        self._last_sequence[sender] = sequence

    def encode(self, message: Message, system_id: int) -> bytes:
        """One MAVLink 2 frame from our component of the system `system_id`."""
        self._out.srcSystem = system_id
        frame: bytes = message.pack(self._out)
        self._out.seq = (self._out.seq + 1) % 256
        return frame
