"""The mission's dictionary: which items the autopilot holds, read from it and kept true."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.codec import Message
from flying_vines.vehicle.mission.item import MissionItem

RETRY_S = 0.8
MOST_ATTEMPTS = 6
TRY_AGAIN_S = 20.0
QUIET_BEFORE_READING_S = 0.5
"""While an upload goes on its totals change: reading waits until they rest."""
SAME_CHANGE_S = 5.0
"""A total that is reported this soon after a reading, and fits it, is not news."""
MOST_ITEMS = 5000


class MissionBook:
    """Reads the mission (MAVLink mission protocol, download side) and knows when it must be read anew.

    A download that somebody else asked for is read as well: so a recording of a companion's link fills the
    book without anybody answering our requests.
    """

    def __init__(self, items: Sequence[MissionItem] = ()) -> None:
        self._items: dict[int, MissionItem] = {item.seq: item for item in items}
        self._given = bool(items)
        self._arriving: dict[int, MissionItem] = {}
        self._expected: int | None = None
        self._total: int | None = None
        self._mission_id: int | None = None
        self._complete_at: float | None = None
        self._changed_at: float | None = None
        self._asked_at = -math.inf
        self._asking = False
        self._attempts = 0
        self._gave_up_at: float | None = None
        self.fresh = bool(items)

    @property
    def arriving(self) -> bool:
        """Whether the autopilot is sending its mission just now."""
        return self._expected is not None

    @property
    def items(self) -> Mapping[int, MissionItem]:
        return self._items

    def doubt(self, t: float) -> None:
        """Something says that the mission is another one now: do not trust the book, read it again."""
        if not self._given:
            self.fresh = False
        self._arriving, self._expected = {}, None  # what has arrived is of the mission before
        self._changed_at = t
        self._attempts = 0
        self._gave_up_at = None

    def refresh(self, t: float) -> None:
        """Read the mission again, and trust the book meanwhile: not every change is announced."""
        self._changed_at = t
        self._attempts = 0
        self._gave_up_at = None

    def read_since(self, t: float) -> bool:
        """Whether the book was read from the autopilot after `t`, and nothing has called it in question."""
        return self.fresh and self._complete_at is not None and self._complete_at > t

    def handle(self, t: float, message: Message) -> None:
        """Take in a message of our autopilot."""
        kind = message.get_type()
        if kind == "MISSION_CURRENT":
            self._watch_for_change(t, message)
        elif kind == "STATUSTEXT" and message.text.startswith("Flight plan received"):
            self.doubt(t)
        elif kind == "MISSION_COUNT" and message.mission_type == 0 and message.count <= MOST_ITEMS:
            self._expected, self._arriving = message.count, {}
            self._progress(t)
        elif (
            kind in ("MISSION_ITEM_INT", "MISSION_ITEM")
            and message.mission_type == 0
            and message.seq < (self._expected or 0)
        ):
            self._arriving[message.seq] = _item(message)
            self._progress(t)

    def _progress(self, t: float) -> None:
        self._asked_at, self._attempts = t - RETRY_S, 0
        if self._expected is not None and len(self._arriving) == self._expected:
            self._items, self._arriving, self._expected = self._arriving, {}, None
            self._complete_at, self._changed_at = t, None
            self._given = False
            self.fresh = True

    def _watch_for_change(self, t: float, message: Message) -> None:
        total, mission_id = message.total, _mission_id(message)
        first = self._total is None
        if first or (total, mission_id) == (self._total, self._mission_id):
            self._total, self._mission_id = total, mission_id
            return
        same_id = mission_id == self._mission_id
        self._total, self._mission_id = total, mission_id
        just_read = self._complete_at is not None and t - self._complete_at < SAME_CHANGE_S
        if just_read and same_id and total == len(self._items) - 1:
            return  # ArduPilot, which does not count the home item, and has no id
        self.doubt(t)

    def requests(self, t: float, system_id: int) -> list[Message]:
        """What to ask the autopilot next; at most one message a call."""
        if self._gave_up_at is not None and t - self._gave_up_at < TRY_AGAIN_S:
            return []
        if self.fresh and self._expected is None and self._changed_at is None:
            return []
        if self._changed_at is not None and t - self._changed_at < QUIET_BEFORE_READING_S:
            return []
        if t - self._asked_at < RETRY_S:
            return []
        if self._attempts >= MOST_ATTEMPTS:
            self._gave_up_at, self._attempts, self._expected = t, 0, None
            return []
        self._asked_at, self._asking = t, True
        self._attempts += 1
        if self._expected is None:
            return [mavlink.MAVLink_mission_request_list_message(system_id, 1, 0)]
        missing = next(seq for seq in range(self._expected) if seq not in self._arriving)
        return [mavlink.MAVLink_mission_request_int_message(system_id, 1, missing, 0)]

    def acknowledgement(self, message: Message, system_id: int) -> list[Message]:
        """The MISSION_ACK that ends a download that we asked for, when `message` was its last item."""
        last = (
            self._asking
            and message.get_type() == "MISSION_ITEM_INT"
            and self._expected is None
            and self.fresh
        )
        if last and message.seq == len(self._items) - 1:
            self._asking = False
            return [mavlink.MAVLink_mission_ack_message(system_id, 1, mavlink.MAV_MISSION_ACCEPTED, 0)]
        return []


def _item(message: Message) -> MissionItem:
    scale = 1e-7 if message.get_type() == "MISSION_ITEM_INT" and message.frame not in (0, 2) else 1.0
    params = (
        message.param1, message.param2, message.param3, message.param4,
        message.x * scale, message.y * scale, message.z,
    )  # fmt: skip
    return MissionItem(
        seq=message.seq,
        command=message.command,
        params=params,
        frame=message.frame,
        current=bool(message.current),
        autocontinue=bool(message.autocontinue),
    )


def _mission_id(message: Message) -> int:
    """PX4's checksum of the mission: an extension of MISSION_CURRENT that the dialect does not name."""
    frame = message.get_msgbuf()
    if not frame or frame[0] != 0xFD:
        return 0
    payload = bytes(frame[10 : 10 + frame[1]])
    return int.from_bytes(payload[6:10], "little")
