"""The queue of all messages to the vehicle, the most important first.

PX4 forwards our messages through a buffer for two messages, and drops the rest. So at most two messages leave
within 20 ms, and at most one of them ranks below an answer. The other place is reserved for an answer or a
heartbeat. When a lower message has waited for 20 ms, the answers leave one place to it: a flood of commands
cannot hide the text of a fault.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Sequence
from enum import IntEnum

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.mission.mission_cache import ItemRequest

_WINDOW_S = 0.02 - 1e-6  # less the rounding of clocks
MAX_IN_WINDOW = 2
MAX_WAITING = 50
"""Queue length: one second of low-ranking messages, half a second of others. A message that waits longer is
out of date, and the sender of a command has repeated it by then."""


class Rank(IntEnum):
    """The order in which messages leave. Messages of one rank leave in the order in which they came."""

    HEARTBEAT = 0
    """Before the answers, so that a flood of commands cannot stop it. At 1 Hz it delays answers by one place
    at most."""
    ANSWER = 1
    TEXT = 2
    REQUEST = 3
    PARAMETER = 4
    VALUE = 5


_RANKS = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: Rank.HEARTBEAT,
    mavlink.MAVLINK_MSG_ID_STATUSTEXT: Rank.TEXT,
    mavlink.MAVLINK_MSG_ID_COMMAND_LONG: Rank.REQUEST,
    mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: Rank.REQUEST,
    mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_INT: Rank.REQUEST,
    mavlink.MAVLINK_MSG_ID_MISSION_ACK: Rank.REQUEST,
    mavlink.MAVLINK_MSG_ID_PARAM_VALUE: Rank.PARAMETER,
    mavlink.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT: Rank.VALUE,
}
"""All other messages are answers: COMMAND_ACK, TIMESYNC, PING, AUTOPILOT_VERSION and the like."""


class TransmitQueue:
    """A queue by rank with a limited rate. All times are seconds of one clock."""

    def __init__(self) -> None:
        self.dropped = 0
        self._count = 0
        self._waiting: dict[Rank, deque[MavlinkMessage]] = {rank: deque() for rank in Rank}
        self._left_at: deque[float] = deque(maxlen=MAX_IN_WINDOW)
        self._low_rank_left_at = -math.inf
        self._low_rank_waits_since = math.inf

    def put(self, message: MavlinkMessage) -> None:
        """Queue a message. If the queue is full, drop one.

        It is the oldest of the lowest rank; but if more than half of the messages are answers, the oldest
        answer to the sender that waits for most. So a flood of one sender delays no other sender's answer. If
        many senders wait for equally many, answers to commands that let air out are the last to be dropped.
        """
        rank = _RANKS.get(message.get_msgId(), Rank.ANSWER)
        self._waiting[Rank.ANSWER if isinstance(message, ItemRequest) else rank].append(message)
        self._count += 1
        if self._count > MAX_WAITING:
            answers = self._waiting[Rank.ANSWER]
            if len(answers) > MAX_WAITING // 2:
                del answers[_to_drop(answers)]
            else:
                self._waiting[max(rank for rank, queue in self._waiting.items() if queue)].popleft()
            self._count -= 1
            self.dropped += 1

    def due(self, t: float) -> list[MavlinkMessage]:
        """The messages that leave at time `t`, in order."""
        leaving: list[MavlinkMessage] = []
        if not self._count:
            return leaving
        if math.isinf(self._low_rank_waits_since) and self._low_rank_waits:
            self._low_rank_waits_since = t
        for rank, queue in self._waiting.items():
            while queue and self._has_room(t, rank):
                leaving.append(queue.popleft())
                self._left_at.append(t)
                if rank > Rank.ANSWER:
                    self._low_rank_left_at = t
                    self._low_rank_waits_since = t if self._low_rank_waits else math.inf
        self._count -= len(leaving)
        return leaving

    @property
    def _low_rank_waits(self) -> bool:
        return any(queue for rank, queue in self._waiting.items() if rank > Rank.ANSWER)

    def _has_room(self, t: float, rank: Rank) -> bool:
        if rank > Rank.ANSWER and t - self._low_rank_left_at < _WINDOW_S:
            return False
        leaves_a_place = rank is Rank.ANSWER and t - self._low_rank_waits_since >= _WINDOW_S
        used = sum(t - left_at < _WINDOW_S for left_at in self._left_at)
        return used + leaves_a_place < MAX_IN_WINDOW


def _to_drop(answers: Sequence[MavlinkMessage]) -> int:
    waits_for = Counter(map(_receiver, answers))
    most = max(waits_for.values())
    busy = [index for index, answer in enumerate(answers) if waits_for[_receiver(answer)] == most]
    return next((index for index in busy if not isinstance(answers[index], AirOutAck)), busy[0])


def _receiver(answer: MavlinkMessage) -> tuple[int, int]:
    return getattr(answer, "target_system", 0), getattr(answer, "target_component", 0)


class AirOutAck(mavlink.MAVLink_command_ack_message):  # type: ignore[misc]
    """COMMAND_ACK for a command that let air out. It is dropped only if all waiting answers are such ones, or
    if its sender is the busiest."""


def acknowledgement(
    command: MavlinkMessage, result: int, percent: int = 0, lets_air_out: bool = False
) -> MavlinkMessage:
    """The answer to a COMMAND_LONG or COMMAND_INT.

    Args:
        command: the command.
        result: MAV_RESULT.
        percent: progress, for the result IN_PROGRESS.
        lets_air_out: the command let air out.
    """
    kind = AirOutAck if lets_air_out else mavlink.MAVLink_command_ack_message
    return kind(command.command, result, percent, 0, command.get_srcSystem(), command.get_srcComponent())
