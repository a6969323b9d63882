"""Everything that we send to the vehicle waits here for its turn: never a burst, and what matters first.

An autopilot passes on what we send through a buffer that may hold two messages and loses the rest (PX4). So
at most two messages leave within any 20 ms, and of what nobody waits for only one: a place is always left for
an answer or a heartbeat.
"""

from __future__ import annotations

import math
from collections import deque
from enum import IntEnum

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.mavlink.codec import Message
from flying_vines.vehicle.mavlink.fuel_status import FuelStatus
from flying_vines.vehicle.mission.book import ItemRequest

_WINDOW_S = 0.02 - 1e-6  # of clocks that count in floating point
MOST_IN_WINDOW = 2
MOST_WAITING = 50
"""A second of what nobody waits for, half of one at full pace: what is later is no news, and the sender of a
command has repeated it by then."""


class Rank(IntEnum):
    """In which order messages leave; those of one rank keep theirs."""

    HEARTBEAT = 0
    """Before the answers, or a flood of commands would silence us. There is one a second: it delays none of
    them by more than one place of two."""
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
    FuelStatus.id: Rank.VALUE,
}
"""Whatever is not here answers somebody: COMMAND_ACK, TIMESYNC, PING, AUTOPILOT_VERSION and the like."""


class Outbox:
    """Messages in, and at each moment those that may leave. All times are seconds of one clock."""

    def __init__(self) -> None:
        self.dropped = 0
        self._count = 0
        self._waiting: dict[Rank, deque[Message]] = {rank: deque() for rank in Rank}
        self._left_at: deque[float] = deque(maxlen=MOST_IN_WINDOW)
        self._patient_left_at = -math.inf

    def put(self, message: Message) -> None:
        """Let a message wait; where there are too many the oldest of the least rank is dropped."""
        rank = _RANKS.get(message.get_msgId(), Rank.ANSWER)
        self._waiting[Rank.ANSWER if isinstance(message, ItemRequest) else rank].append(message)
        self._count += 1
        if self._count > MOST_WAITING:
            least = max(rank for rank, queue in self._waiting.items() if queue)
            self._waiting[least].popleft()
            self._count -= 1
            self.dropped += 1

    def due(self, t: float) -> list[Message]:
        """What leaves at time `t`, in order."""
        leaving: list[Message] = []
        if not self._count:
            return leaving
        for rank, queue in self._waiting.items():
            while queue and self._has_room(t, rank):
                leaving.append(queue.popleft())
                self._left_at.append(t)
                if rank > Rank.ANSWER:
                    self._patient_left_at = t
        self._count -= len(leaving)
        return leaving

    def _has_room(self, t: float, rank: Rank) -> bool:
        if rank > Rank.ANSWER and t - self._patient_left_at < _WINDOW_S:
            return False
        return len(self._left_at) < MOST_IN_WINDOW or t - self._left_at[0] >= _WINDOW_S
