"""A companion that only requests and listens: which messages arrive from the vehicle, and how often.

Sans-IO; all times are seconds of one clock. It requests streams and mission with the service's own code, so
the service will receive the same messages. It answers no request and obeys no command.
"""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.config.address import Address
from flying_vines.config.config import Config
from flying_vines.core.core import LISTEN_FIRST_S
from flying_vines.service.host_clock import synchronised
from flying_vines.vehicle.component.component import DuplicateIdDetector
from flying_vines.vehicle.component.telemetry import Heartbeat
from flying_vines.vehicle.component.transmit_queue import TransmitQueue
from flying_vines.vehicle.mavlink.codec import MavlinkCodec, MavlinkMessage
from flying_vines.vehicle.mavlink.link import buffered_frames, open_link, unread_from
from flying_vines.vehicle.mavlink.signing import RefusedFrames, Signing
from flying_vines.vehicle.mission.item import MissionItem
from flying_vines.vehicle.mission.mission_cache import MissionCache
from flying_vines.vehicle.radio.rc import RadioLink, RadioParameters
from flying_vines.vehicle.radio.switch import MovedUnseen, SwitchMove, SwitchReader, SwitchReady
from flying_vines.vehicle.state import Ambiguous, VehicleState
from flying_vines.vehicle.streams import Streams, Wanted
from flying_vines.vehicle.triggers import messages_of, own_triggers

SETTLE_S = 1.5
"""Time from the first heartbeat until the requested streams have their rate."""
ENOUGH = 4
"""Minimum number of messages for a rate."""
VERSION_AGAIN_S = 1.0
TICK_S = 0.02
_SIGNED = 1
"""Incompatibility flag of a signed MAVLink 2 frame."""


@dataclass(frozen=True, slots=True)
class StreamFacts:
    """A message that the service uses."""

    name: str
    wanted_Hz: float
    rate_Hz: float
    """0 if it does not arrive."""
    essential: bool
    refused: bool
    """The autopilot refused the request for it."""


@dataclass(frozen=True, slots=True)
class SwitchFacts:
    """The switch's channel."""

    problem: str | None
    """Why the channel cannot be trusted; None if it can."""
    pulse_us: int = 0
    position: int | None = None
    """Counted from 0 at the lowest pulse width; None before it has settled."""
    seen: frozenset[int] = frozenset()
    """All positions in which the switch came to rest."""
    hides_loss: str = ""
    """The parameter that lets the autopilot hide RC loss; empty if none does."""
    other_use: str = ""
    """The autopilot's parameter that gives the channel another use; empty if there is none."""
    bends_late: bool = False
    """True on PX4 with an unknown receiver failsafe: each bend waits for the RC status."""


@dataclass(frozen=True, slots=True)
class VehicleFacts:
    """What arrived on the vehicle's link."""

    down: str = ""
    """Why the link is down, if it is."""
    bytes: int = 0
    unread_from: str = ""
    """The IP address of an ignored sender: the link names another peer."""
    echoes: int = 0
    """Our own frames that came back."""
    buffered: int | None = None
    """The number of frames that the system keeps while we do not read; None if the link is not UDP."""
    messages: int = 0
    """Accepted messages of any sender."""
    refused: RefusedFrames = field(default_factory=RefusedFrames)
    """Messages refused because of their signature."""
    others: tuple[tuple[int, int], ...] = ()
    """System and component of the other senders."""
    rivals: tuple[int, int] | None = None
    """Two autopilots on the link; neither was chosen."""
    system_id: int = 0
    """The autopilot that the service would serve; 0 if none was found."""
    kind: str = "unknown"
    version: str = ""
    armed: bool = False
    mode: str = ""
    longest_silence_s: float = 0.0
    """Between two messages of the autopilot, or since its last message."""
    heartbeat_Hz: float = 0.0
    heartbeat_missing: bool = False
    """Other messages of the autopilot arrive, but no heartbeat."""
    streams: tuple[StreamFacts, ...] = ()
    duplicate_id: bool = False
    """Another program uses our system and component id."""
    signs: bool = False
    """The autopilot signs its messages."""
    answers: bool = False
    """The autopilot has answered a request of ours."""
    radio: SwitchFacts = SwitchFacts("no RC_CHANNELS yet")
    mission: Mapping[int, MissionItem] | None = None
    """None if it was not read."""
    ahead_s: float | None = None
    """This computer's clock minus the autopilot's; None if the autopilot does not know the time."""

    @property
    def found(self) -> bool:
        """True if there is an autopilot to serve."""
        return self.system_id != 0


@dataclass(slots=True)
class _Rate:
    """The rate of a message since the streams settled."""

    settled_at: float
    first_at: float
    last_at: float
    count: int = 1

    def per_s(self, t: float, wanted_Hz: float) -> float:
        """0 if it no longer arrives."""
        if t - self.last_at > max(2.0, 3.0 / wanted_Hz):
            return 0.0
        if self.count < ENOUGH:
            # Too few messages for a rate: take the maximum possible rate.
            return min(wanted_Hz, (self.count + 1) / max(1e-6, t - self.settled_at))
        return (self.count - 1) / max(1e-6, self.last_at - self.first_at)


class VehicleProbe:
    """Call `take` for every message, and send what `due` returns. `facts` may be called at any time."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._state = VehicleState(config.vehicle.system_id)
        self._streams = Streams(config.vehicle.rc_rate_Hz, messages_of(own_triggers(config.triggers)))
        self._radio = RadioLink(config.switch, config.losses.rc_s)
        self._parameters = RadioParameters(config.switch.channel)
        self._switch = SwitchReader.of(config.switch)
        self._mission_cache = MissionCache()
        self._heartbeat = Heartbeat()
        self._queue = TransmitQueue()
        self._duplicate_id = DuplicateIdDetector(config.vehicle.component_id)
        self._duplicate_id_found = False
        self._rivals: tuple[int, int] | None = None
        self._began_at: float | None = None
        self._found_at: float | None = None
        self._longest_silence_s = 0.0
        self._rates: dict[str, _Rate] = {}
        self._senders: Counter[tuple[int, int]] = Counter()
        self._signs = self._answers = False
        self._seen: set[int] = set()
        self._version = ""
        self._version_asked_at: float | None = None
        self._ahead_s: float | None = None

    def take(self, t: float, unix_s: float, message: MavlinkMessage) -> None:
        """Take in a message of any sender; `unix_s` is the time of this computer's clock."""
        sender = message.get_srcSystem(), message.get_srcComponent()
        self._senders[sender] += 1
        if self._state.is_ours(message):
            self._longest_silence_s = self._silence_s(t)
        for event in self._state.handle(t, message):
            if isinstance(event, Ambiguous):
                self._rivals = event.system_ids
        if not self._state.found:
            return
        if sender == (self._state.system_id, self._config.vehicle.component_id):
            self._duplicate_id_found |= bool(self._duplicate_id.received(t))
        elif self._state.is_ours(message):
            self._take_ours(t, unix_s, message)

    def _take_ours(self, t: float, unix_s: float, message: MavlinkMessage) -> None:
        kind = message.get_type()
        frame = message.get_msgbuf()
        self._signs |= frame[0] == mavlink.PROTOCOL_MARKER_V2 and bool(frame[2] & _SIGNED)
        if self._found_at is None:
            self._found_at = t
        settled_at = self._found_at + SETTLE_S
        if t >= settled_at:
            rate = self._rates.get(kind)
            if rate is None:
                self._rates[kind] = _Rate(settled_at, t, t)
            else:
                rate.last_at, rate.count = t, rate.count + 1
        self._streams.handle(t, message)
        self._mission_cache.handle(t, message)
        self._radio.autopilot = self._state.autopilot
        self._radio.handle(t, message)
        if kind == "PARAM_VALUE":
            self._parameters.handle(self._state.autopilot, message)
        if kind == "RC_CHANNELS":
            self._sample_switch(t)
        elif kind == "AUTOPILOT_VERSION":
            number = message.flight_sw_version
            self._version = ".".join(str(number >> shift & 0xFF) for shift in (24, 16, 8))
        elif kind == "COMMAND_ACK":
            us = self._state.system_id, self._config.vehicle.component_id
            self._answers |= (message.target_system, message.target_component) == us
        elif kind == "SYSTEM_TIME" and message.time_unix_usec:
            self._ahead_s = unix_s - message.time_unix_usec / 1e6

    def _silence_s(self, t: float) -> float:
        return max(self._longest_silence_s, self._state.silence_s(t) or 0.0)

    def _sample_switch(self, t: float) -> None:
        if self._radio.problem(t) is not None:
            self._switch.lose()
            return
        event = self._switch.sample(t, self._radio.switch_us)
        if isinstance(event, (SwitchMove, MovedUnseen, SwitchReady)):
            self._seen.add(event.position)

    def due(self, t: float) -> list[MavlinkMessage]:
        """The messages to send at `t`: our heartbeat and our requests."""
        self._began_at = t if self._began_at is None else self._began_at
        if not self._state.found:
            # Some peers send only after they have received a message.
            may_send = t - self._began_at >= LISTEN_FIRST_S and self._rivals is None
            return self._heartbeat.due(t, mavlink.MAV_STATE_STANDBY) if may_send else []
        system_id = self._state.system_id
        for message in (
            *self._heartbeat.due(t, mavlink.MAV_STATE_STANDBY),
            *self._streams.requests(t, system_id),
            *self._mission_cache.requests(t, system_id),
            *self._mission_cache.acknowledgement(system_id),
            *self._parameters.requests(t, system_id, self._state.autopilot),
            *self._ask_version(t, system_id),
        ):
            self._queue.put(message)
        return self._queue.due(t)

    def _ask_version(self, t: float, system_id: int) -> list[MavlinkMessage]:
        asked_at = self._version_asked_at
        if self._version or (asked_at is not None and t - asked_at < VERSION_AGAIN_S):
            return []
        self._version_asked_at = t
        return [
            mavlink.MAVLink_command_long_message(
                system_id, 1, mavlink.MAV_CMD_REQUEST_MESSAGE, 0,
                mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION, 0, 0, 0, 0, 0, 0,
            )
        ]  # fmt: skip

    @property
    def system_id(self) -> int:
        """Our system id: the vehicle's, or a guess until it is known."""
        return self._state.system_id or self._config.vehicle.system_id or 1

    def radio(self, t: float) -> SwitchFacts:
        """The present state of the switch."""
        autopilot = self._state.autopilot
        watched = self._radio.by_receiver or not autopilot.needs_rc_status
        return SwitchFacts(
            self._radio.problem(t),
            self._radio.switch_us,
            self._switch.position,
            frozenset(self._seen),
            autopilot.hides_rc_loss(self._parameters.values) if watched else "",
            autopilot.other_use(self._config.switch.channel, self._parameters.values),
            autopilot.needs_rc_status and watched and self._config.switch.receiver_failsafe == "unknown",
        )

    def facts(self, t: float) -> VehicleFacts:
        """All facts until `t`."""
        state = self._state
        autopilot = state.system_id, mavlink.MAV_COMP_ID_AUTOPILOT1
        heartbeat = self._rates.get("HEARTBEAT")
        return VehicleFacts(
            messages=self._senders.total(),
            others=tuple(sorted(sender for sender in self._senders if sender != autopilot)),
            rivals=self._rivals,
            system_id=state.system_id,
            kind=state.kind,
            version=self._version,
            armed=state.armed,
            mode=state.mode,
            longest_silence_s=self._silence_s(t),
            heartbeat_Hz=heartbeat.per_s(t, 1.0) if heartbeat else 0.0,
            heartbeat_missing=state.heartbeat_missing,
            streams=tuple(self._stream(t, name, wanted) for name, wanted in self._streams.wanted(t).items()),
            duplicate_id=self._duplicate_id_found,
            signs=self._signs,
            answers=self._answers,
            radio=self.radio(t),
            mission=self._mission_cache.items if self._mission_cache.fresh else None,
            ahead_s=self._ahead_s,
        )

    def _stream(self, t: float, name: str, wanted: Wanted) -> StreamFacts:
        rate = self._rates.get(name)
        rate_Hz = rate.per_s(t, wanted.rate_Hz) if rate else 0.0
        return StreamFacts(name, wanted.rate_Hz, rate_Hz, wanted.essential, wanted.refused)


class VehicleWatch:
    """Listens and sends requests at `address` while `run` runs. Times are the event loop's."""

    def __init__(
        self,
        address: Address,
        config: Config,
        signing: Signing | None = None,
        probe: VehicleProbe | None = None,
    ) -> None:
        self.probe = probe or VehicleProbe(config)
        self._down = "it was not opened"
        self._signing = signing
        self._synchronised = bool(synchronised())
        self._codec = MavlinkCodec(config.vehicle.system_id, config.vehicle.component_id, signing)
        self._received = 0
        self._link = open_link(address, self._bytes, self._state, self._stranger)

    @property
    def t(self) -> float:
        return asyncio.get_running_loop().time()

    @property
    def facts(self) -> VehicleFacts:
        refused = self._signing.refused if self._signing else RefusedFrames()
        return replace(
            self.probe.facts(self.t),
            down=self._down,
            bytes=self._received,
            refused=refused,
            unread_from=unread_from(self._link),
            echoes=self._codec.echoes,
            buffered=buffered_frames(self._link),
        )

    async def run(self, over: Callable[[], bool]) -> None:
        opening = asyncio.create_task(self._link.run())
        try:
            while not over() and not opening.done():
                if self._signing is not None:
                    self._signing.advance(time.time(), self.t, self._synchronised)
                for message in self.probe.due(self.t):
                    self._link.write(self._codec.encode(message, self.probe.system_id))
                await asyncio.sleep(TICK_S)
        finally:
            opening.cancel()
            await asyncio.wait([opening])
        if not opening.cancelled():
            opening.result()

    def _bytes(self, data: bytes) -> None:
        self._received += len(data)
        self._take(self._codec.decode(data, self.t))

    def _stranger(self, data: bytes, enter: Callable[[], None]) -> None:
        self._received += len(data)
        messages, proven = self._codec.decode_stranger(data, self.t)
        if proven:
            enter()
        self._take(messages)

    def _take(self, messages: Sequence[MavlinkMessage]) -> None:
        now, unix_s = self.t, time.time()
        for message in messages:
            self.probe.take(now, unix_s, message)

    def _state(self, up: bool, why: str) -> None:
        self._down = "" if up else why
