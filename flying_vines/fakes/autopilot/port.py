"""One link of the autopilot: its codec, its counters, the streams it asked for."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.fakes.autopilot.agenda import Entry

_KNOWN = frozenset(message_class.msgname for message_class in mavlink.mavlink_map.values())


@dataclass(slots=True)
class Stream:
    """One message sent again and again."""

    interval_s: float
    entry: Entry


@dataclass(slots=True)
class Port:
    """A link as the autopilot knows it.

    Each port counts its own MAVLink sequence. `active` means that something was heard on it, `hears_gcs` that
    it was a ground station's heartbeat.
    """

    name: str
    system_id: int
    active: bool = False
    hears_gcs: bool = False
    streams: dict[int, Stream] = field(default_factory=dict)
    _encoder: Any = None
    _decoder: Any = None

    def __post_init__(self) -> None:
        self.reboot()

    def reboot(self) -> None:
        """Everything learnt is forgotten; the sequence restarts at 0."""
        for stream in self.streams.values():
            stream.entry.cancel()
        self.streams = {}
        self.active = self.hears_gcs = False
        self._encoder = mavlink.MAVLink(None, srcSystem=self.system_id, srcComponent=1)
        self._decoder = mavlink.MAVLink(None)
        self._decoder.robust_parsing = True

    def encode(self, message: Any) -> bytes:
        frame = bytes(message.pack(self._encoder))
        self._encoder.seq = (self._encoder.seq + 1) % 256
        return frame

    def decode(self, data: bytes) -> list[Any]:
        """The good messages in `data`; what is damaged or unknown is dropped, as a CRC failure would be."""
        messages = self._decoder.parse_buffer(data) or []
        return [message for message in messages if message.get_type() in _KNOWN]
