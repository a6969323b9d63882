"""The links of the autopilot: codecs, routes learnt from senders, forwarding, mutes and stalls."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.simulation.autopilot.scheduler import ScheduledCallback, Scheduler
from flying_vines.vehicle.mission.item import AutopilotKind

COMPANION, GCS, USB = "companion", "gcs", "usb"
"""Names of links."""
PX4_BUFFER = 2
"""Number of messages that wait to be forwarded to one link."""
_KNOWN = frozenset(message_class.msgname for message_class in mavlink.mavlink_map.values())
_PX4_EVERY_S = 0.01
_SIGNING_EPOCH_S = 1_420_070_400
_RADIO_STATUS = {109, 166}
_AUTOPILOT_COMPONENT = 1
_MAX_ROUTES = 20
_MAX_PORTS = 255
_GCS_TYPE = 6


class PortStream(NamedTuple):
    """One periodic message."""

    interval_s: float
    next: ScheduledCallback


@dataclass(slots=True)
class Port:
    """A link of the autopilot: codec, counters and requested streams.

    Each port has its own MAVLink sequence. `active`: the port has received a message. `has_gcs`: the port has
    received a ground station's heartbeat. With a `key` the port signs its messages, and accepts unsigned
    messages only on USB; unsigned RADIO and RADIO_STATUS are accepted on all ports. A port named "companion"
    is PX4's MAV_1 in onboard mode.
    """

    name: str
    system_id: int
    number: int
    key: bytes | None
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
        self.streams = {}
        self.active = self.has_gcs = False
        self._encoder = mavlink.MAVLink(None, srcSystem=self.system_id, srcComponent=_AUTOPILOT_COMPONENT)
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
        return [message for message in messages if message.get_type() in _KNOWN]

    def _may_be_unsigned(self, mav: Any, message_id: int) -> bool:
        return self.name == USB or message_id in _RADIO_STATUS


@dataclass(slots=True)
class _Stall:
    """A link that delays its frames."""

    both_ways: bool
    until_s: float = 0.0
    outgoing: list[bytes] = field(default_factory=list)
    incoming: list[bytes] = field(default_factory=list)


class Links:
    """All ports. Sent frames are queued until they are taken.

    Frames for others are forwarded unchanged, if both links take part in forwarding: at once on ArduPilot.
    PX4 sends one forwarded message per loop of a link, here every 10 ms as on a slow link. Frames that arrive
    while the link's buffer is full are lost.
    """

    def __init__(
        self, kind: AutopilotKind, system_id: int, scheduler: Scheduler, key: bytes | None, unix_s: float
    ) -> None:
        """`unix_s`: the autopilot's clock when the scheduler's time is 0."""
        self.ports: dict[str, Port] = {}
        self.up = False
        """The autopilot runs. Otherwise nothing is sent or received."""
        self._kind = kind
        self._system_id = system_id
        self._scheduler = scheduler
        self._key = key
        self._unix_s = unix_s
        self._link_of: dict[tuple[int, int], str] = {}
        """(system, component) -> link. Routes never expire; a reboot forgets them."""
        self._buffers: dict[str, deque[bytes]] = {}
        self._sent: list[tuple[str, bytes]] = []
        self._stalls: dict[str, _Stall] = {}
        self._muted_until_s = -1.0

    @property
    def unix_s(self) -> float:
        """The autopilot's clock."""
        return self._unix_s + self._scheduler.now_s

    def add(self, name: str) -> Port:
        port = self.ports[name] = Port(name, self._system_id, len(self.ports) % _MAX_PORTS, self._key)
        return port

    def reboot(self) -> None:
        """Nothing is sent or received, and all learnt state is forgotten."""
        self.up = False
        for port in self.ports.values():
            port.reboot()
        self._link_of.clear()
        self._buffers.clear()

    def send(self, port: Port, message: Any) -> None:
        if self.up:
            port.set_time(self.unix_s)
            self._transmit(port.name, port.encode(message))

    def send_to(self, link: str, message: Any) -> None:
        self.send(self.ports[link], message)

    def tell(self, message: Any) -> None:
        """Send to all links that have received a message."""
        for port in self.ports.values():
            if port.active:
                self.send(port, message)

    @property
    def hears(self) -> bool:
        """Received bytes arrive."""
        return self.up and not self._muted

    def decode(self, port: Port, data: bytes) -> list[Any]:
        """The valid messages in received bytes."""
        port.set_time(self.unix_s)
        return port.decode(data)

    def route(self, source: Port, message: Any) -> bool:
        """Forward a received message. True if the autopilot handles it itself."""
        frame = bytes(message.get_msgbuf())
        self._learn(message.get_srcSystem(), message.get_srcComponent(), source.name)
        if message.get_type() == "HEARTBEAT":
            source.has_gcs |= message.type == _GCS_TYPE
            self._forward(source, self.ports, frame)
            return False
        to = getattr(message, "target_system", 0), getattr(message, "target_component", 0)
        links, handles = self._decide(source.name, *to)
        self._forward(source, links, frame)
        return handles

    def _learn(self, system: int, component: int, link: str) -> None:
        own, address = (self._system_id, _AUTOPILOT_COMPONENT), (system, component)
        has_room = address in self._link_of or len(self._link_of) < _MAX_ROUTES
        if system and address != own and has_room:
            self._link_of[address] = link

    def _decide(self, source: str, system: int, component: int) -> tuple[list[str], bool]:
        """The links to forward a message for (system, component) to, where 0 means all, and whether the
        autopilot handles it itself."""
        ours = system in (0, self._system_id)
        local = ours and component in (0, _AUTOPILOT_COMPONENT)
        if local and system and component:
            return [], True
        links = [
            link
            for (to_system, to_component), link in self._link_of.items()
            if link != source
            and (system == 0 or (to_system == system and (not ours or component in (0, to_component))))
        ]
        # A quirk: ArduPilot itself handles messages for an unknown component of its system.
        local |= not links and ours and self._kind == "ardupilot"
        return list(dict.fromkeys(links)), local

    def _forward(self, source: Port, links: Iterable[str], frame: bytes) -> None:
        for port in map(self.ports.__getitem__, links):
            if not (source.forwards and port.forwards and port.active and port is not source):
                continue
            if self._kind == "ardupilot":
                self._transmit(port.name, frame)
                continue
            buffer = self._buffers.setdefault(port.name, deque())
            if len(buffer) < PX4_BUFFER:
                buffer.append(frame)
                if len(buffer) == 1:
                    self._scheduler.after(_PX4_EVERY_S, partial(self._forward_next, port.name))

    def _forward_next(self, link: str) -> None:
        buffer = self._buffers[link]
        self._transmit(link, buffer.popleft())
        if buffer:
            self._scheduler.after(_PX4_EVERY_S, partial(self._forward_next, link))

    # Errors of the links: a mute drops bytes, a stall delays them.

    @property
    def _muted(self) -> bool:
        return self._scheduler.now_s < self._muted_until_s

    def mute(self, seconds: float) -> None:
        self._muted_until_s = self._scheduler.now_s + seconds

    def stall(self, link: str, seconds: float, both_ways: bool) -> None:
        stall = self._stalls.setdefault(link, _Stall(both_ways))
        stall.both_ways, stall.until_s = both_ways, self._scheduler.now_s + seconds

    def _transmit(self, link: str, frame: bytes) -> None:
        if self._muted:
            return
        if link in self._stalls:
            self._stalls[link].outgoing.append(frame)
        else:
            self._sent.append((link, frame))

    def delays(self, link: str, data: bytes) -> bool:
        """Store received bytes if their link is stalled both ways. True if they were stored."""
        stall = self._stalls.get(link)
        if stall is None or not stall.both_ways:
            return False
        stall.incoming.append(data)
        return True

    def end_stalls(self) -> list[tuple[str, bytes]]:
        """End the stalls whose time is over, and return their received bytes. Their frames are sent first."""
        received = []
        for link, stall in list(self._stalls.items()):
            if self._scheduler.now_s >= stall.until_s:
                del self._stalls[link]
                self._sent[:0] = [(link, frame) for frame in stall.outgoing]
                received += [(link, data) for data in stall.incoming]
        return received

    def take(self) -> list[tuple[str, bytes]]:
        """The frames sent since the last call."""
        taken, self._sent = self._sent, []
        return taken
