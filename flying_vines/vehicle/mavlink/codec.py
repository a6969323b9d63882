"""Bytes to MAVLink messages and back, without input or output."""

from __future__ import annotations

from collections import deque
from collections.abc import Container

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.mavlink.frames import Frame, Frames
from flying_vines.vehicle.mavlink.payloads import HeaderOnly, MavlinkMessage, message_of
from flying_vines.vehicle.mavlink.signing import Signing

__all__ = ["MavlinkCodec", "MavlinkMessage"]

REMEMBERED_FRAMES = 32
"""Frames stored per sender to recognise copies. Far fewer than 256, after which the sequence repeats."""

COPIES_WITHIN_S = 2.0
"""A frame with the same sequence number and content within this time is a copy. A program that was started
again counts from 0 again, so its frames may equal those of its last run."""

_ANSWERED = (
    *(mavlink.MAVLINK_MSG_ID_COMMAND_LONG, mavlink.MAVLINK_MSG_ID_COMMAND_INT),
    *(mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ, mavlink.MAVLINK_MSG_ID_PARAM_SET),
)
"""`vehicle/repeats.py` recognises copies of these: each is answered, and a vent acts each time."""

REMEMBERED_SENT = 128
"""Our own frames stored to recognise their echoes; they cover some seconds."""

MAX_SENDERS = 64
"""More than the components of any vehicle. With a limit, forged senders cannot fill the memory."""

_WITH_KEY = mavlink.MAVLINK_MSG_ID_SETUP_SIGNING
"""This message has a secret key. Decoding removes the key, because no log may contain one."""


class MavlinkCodec:
    """Decodes a byte stream, and encodes messages as one component of one system.

    A frame that arrives twice (the same sequence number and checksum from the same sender, due to routers and
    retries) is decoded once; only unsigned requests that get an answer are decoded each time. Our own frames
    that a router sends back are dropped. With `signing`, only frames signed with its key are accepted, and
    ours are signed.
    Decoding raises no exception.

    With `read`, only messages with these ids get their fields; the others are `HeaderOnly`, which costs less.
    """

    def __init__(
        self,
        system_id: int,
        component_id: int,
        signing: Signing | None = None,
        read: Container[int] = mavlink.mavlink_map,
    ) -> None:
        self.lost_frames = 0
        self.repeated_frames = 0
        self.echoes = 0
        self._frames = Frames()
        self._senders: dict[tuple[int, int], _Sender] = {}
        self._component_id = component_id
        self._signing = signing
        self._read = read
        self._sent: deque[tuple[int, int, int, int]] = deque(maxlen=REMEMBERED_SENT)
        self._out = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        if signing is not None:
            self._out.signing.secret_key = signing.key
            self._out.signing.sign_outgoing = True

    @property
    def bad_frames(self) -> int:
        """The number of frames with a wrong checksum and of byte sequences that are not frames."""
        return self._frames.bad_frames

    def decode(self, data: bytes, t: float = 0.0) -> list[MavlinkMessage]:
        """The messages that `data` completes, in order; only of known types with a correct checksum.

        `t`: when they arrived, to recognise copies.
        """
        return self._admitted(self._frames.take(data), t)

    def decode_stranger(self, data: bytes, t: float = 0.0) -> tuple[list[MavlinkMessage], bool]:
        """The messages in one datagram of a new sender, and True if a signature proves an autopilot.

        An incomplete frame at the end is dropped, so that it does not mix with other senders' bytes.
        """
        messages = self._admitted(Frames().take(data), t)
        proven = self._signing is not None and any(
            message.get_srcComponent() == mavlink.MAV_COMP_ID_AUTOPILOT1 for message in messages
        )
        return messages, proven

    def _admitted(self, frames: list[Frame], t: float) -> list[MavlinkMessage]:
        messages = []
        for frame in frames:
            if frame.component == self._component_id and self._is_echo(frame):
                self.echoes += 1
                continue
            sender = self._senders.get((frame.system, frame.component))
            answered = frame.message_id in _ANSWERED and self._signing is None
            if sender is not None and not answered and sender.is_copy(frame, t):
                self.repeated_frames += 1
                continue
            if self._signing is not None and not self._signing.admits(frame):
                continue
            if sender is None:
                if not frame.known:
                    continue
                sender = self._meet(frame)
            if lost := sender.take(frame, t):
                self.lost_frames = max(0, self.lost_frames + lost)
            if not frame.known:
                continue
            if frame.message_id == _WITH_KEY:
                messages.append(_without_key(frame))
            else:
                messages.append(message_of(frame) if frame.message_id in self._read else HeaderOnly(frame))
        return messages

    def encode(self, message: MavlinkMessage, system_id: int) -> bytes:
        """One MAVLink 2 frame from our component of the system `system_id`."""
        self._out.srcSystem = system_id
        if self._signing is not None:
            self._out.signing.link_id = self._signing.link_id
            self._out.signing.timestamp = self._signing.next_timestamp()
        raw: bytes = message.pack(self._out)
        self._sent.append((system_id, self._out.seq, message.get_msgId(), message.get_crc()))
        self._out.seq = (self._out.seq + 1) % 256
        return raw

    def _is_echo(self, frame: Frame) -> bool:
        return (frame.system, frame.sequence, frame.message_id, frame.checksum) in self._sent

    def _meet(self, frame: Frame) -> _Sender:
        if len(self._senders) >= MAX_SENDERS:
            # Drop the sender with the fewest frames, so that many new senders cannot replace a busy one.
            del self._senders[min(self._senders, key=lambda sender: self._senders[sender].frames)]
        sender = _Sender(frame.sequence)
        self._senders[frame.system, frame.component] = sender
        return sender


def _without_key(frame: Frame) -> MavlinkMessage:
    target = message_of(frame)
    sender = mavlink.MAVLink(None, frame.system, frame.component)
    sender.seq = frame.sequence
    blank = mavlink.MAVLink_setup_signing_message(target.target_system, target.target_component, [0] * 32, 0)
    return message_of(Frames().take(blank.pack(sender))[0])


class _Sender:
    """The latest frames of one component of one system."""

    __slots__ = ("_recent", "_sequence", "frames")

    def __init__(self, sequence: int) -> None:
        self.frames = 0
        self._sequence = (sequence - 1) & 0xFF
        self._recent: deque[tuple[int, int, int, float]] = deque(maxlen=REMEMBERED_FRAMES)

    def is_copy(self, frame: Frame, t: float) -> bool:
        # If a router forwards only some frames, sequence numbers repeat soon. A frame ahead of the latest one
        # is not a copy.
        behind = (self._sequence - frame.sequence) & 0xFF
        return behind < 128 and any(
            (sequence, message_id, checksum) == (frame.sequence, frame.message_id, frame.checksum)
            and t - at < COPIES_WITHIN_S
            for sequence, message_id, checksum, at in self._recent
        )

    def take(self, frame: Frame, t: float) -> int:
        """The number of newly lost frames; -1 if this frame was late and had been counted as lost."""
        self.frames += 1
        if frame.known:
            self._recent.append((frame.sequence, frame.message_id, frame.checksum, t))
        ahead = (frame.sequence - self._sequence) & 0xFF
        if ahead >= 256 - REMEMBERED_FRAMES:
            return -1
        self._sequence = frame.sequence
        return max(0, ahead - 1)
