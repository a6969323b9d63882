"""One link of the autopilot: codec, counters and requested streams."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.simulation.autopilot.scheduler import ScheduledCallback

COMPANION, GCS, USB = "companion", "gcs", "usb"
"""Names of links."""
KNOWN = frozenset(message_class.msgname for message_class in mavlink.mavlink_map.values())
PX4_EXTRA_MESSAGES = frozenset({"UNKNOWN_371"})
"""FUEL_STATUS, which PX4 forwards. It is in PX4's dialect, but not in ardupilotmega."""
_SIGNING_EPOCH_S = 1_420_070_400
_RADIO_STATUS = {109, 166}


@dataclass(slots=True)
class PortStream:
    """One periodic message."""

    interval_s: float
    entry: ScheduledCallback


@dataclass(slots=True)
class Port:
    """A link of the autopilot.

    Each port has its own MAVLink sequence. `active`: the port has received a message. `has_gcs`: the port has
    received a ground station's heartbeat. With a `key` the port signs its messages, and accepts unsigned
    messages only on USB; unsigned RADIO and RADIO_STATUS are accepted on all ports. A port named "companion"
    is PX4's MAV_1 in onboard mode.
    """

    name: str
    system_id: int
    number: int = 0
    key: bytes | None = None
    known: frozenset[str] = KNOWN
    forwards: bool = True
    active: bool = False
    has_gcs: bool = False
    streams: dict[int, PortStream] = field(default_factory=dict)
    rc_updates: int = 0
    echoed: int = 0
    _encoder: Any = None
    _decoder: Any = None

    def __post_init__(self) -> None:
        self.reboot()

    def reboot(self) -> None:
        """Forget all learnt state; the sequence restarts at 0."""
        for stream in self.streams.values():
            stream.entry.cancel()
        self.streams = {}
        self.active = self.has_gcs = False
        self._encoder = mavlink.MAVLink(None, srcSystem=self.system_id, srcComponent=1)
        self._decoder = mavlink.MAVLink(None)
        self._decoder.robust_parsing = True
        if self.key is not None:
            self._encoder.signing.secret_key = self._decoder.signing.secret_key = self.key
            self._encoder.signing.sign_outgoing = True
            self._encoder.signing.link_id = self.number
            self._decoder.signing.allow_unsigned_callback = self._may_be_unsigned

    def set_time(self, unix_s: float) -> None:
        """Set the time for signatures; it never decreases."""
        self._advance_signing(int((unix_s - _SIGNING_EPOCH_S) * 1e5))

    def _advance_signing(self, timestamp: int) -> None:
        for end in (self._encoder, self._decoder):
            end.signing.timestamp = max(end.signing.timestamp, timestamp)

    def encode(self, message: Any) -> bytes:
        frame = bytes(message.pack(self._encoder))
        self._encoder.seq = (self._encoder.seq + 1) % 256
        return frame

    def decode(self, data: bytes) -> list[Any]:
        """The valid messages in `data`. Damaged and unknown ones are dropped."""
        messages = self._decoder.parse_buffer(data) or []
        # Accepted signatures advance the signing clock.
        self._advance_signing(self._decoder.signing.timestamp)
        return [message for message in messages if message.get_type() in self.known]

    def _may_be_unsigned(self, mav: Any, message_id: int) -> bool:
        return self.name == USB or message_id in _RADIO_STATUS
