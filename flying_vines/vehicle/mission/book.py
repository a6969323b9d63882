"""The mission's dictionary: which items the autopilot holds, read from it and kept true."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.codec import Message
from flying_vines.vehicle.mission.execution import same_numbers
from flying_vines.vehicle.mission.item import MissionItem, has_place, is_nav

RETRY_S = 0.8
MOST_ATTEMPTS = 6
TRY_AGAIN_S = 20.0
QUIET_BEFORE_READING_S = 0.5
"""While an upload goes on its totals change: reading waits until they rest."""
SAME_CHANGE_S = 5.0
"""A total that is reported this soon after a reading, and fits it, is not news."""
MOST_ITEMS = 5000
LOOK_AGAIN_S = 2.0
LOOK_RETRY_S = 0.5
MISSION_RUNS = 3
"""MISSION_CURRENT.mission_state while the vehicle flies its mission."""


class MissionBook:
    """Reads the mission (MAVLink mission protocol, download side) and knows when it must be read anew.

    A download that somebody else asked for is read as well: so a recording of a companion's link fills the
    book without anybody answering our requests.

    ArduPilot has no identity of a mission: one that is replaced by another of the same length shows in
    nothing that it sends. So in flight what runs next is looked at again and again, the rest in turn.
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
        self._owes_ack = False
        self._current: int | None = None
        self._look_at: list[int] = []
        self._look_since = self._looked_at = -math.inf
        self._in_turn = 0
        self.fresh = bool(items)

    @property
    def arriving(self) -> bool:
        """Whether the autopilot is sending its mission just now."""
        return self._expected is not None

    @property
    def items(self) -> Mapping[int, MissionItem]:
        return self._items

    def nearest(self, command: int, params: Sequence[float], seq: int) -> MissionItem | None:
        """Of the items of this kind with these first four numbers, the one nearest to item `seq`.

        Of two that are as near, the one ahead: what the vehicle says of where it is comes late.
        """
        alike = [
            item
            for item in self._items.values()
            if item.command == command and same_numbers(item.params[:4], params[:4])
        ]
        return min(alike, key=lambda item: (abs(item.seq - seq), -item.seq), default=None)

    def doubt(self, t: float) -> None:
        """Something says that the mission is another one now: do not trust the book, read it again."""
        if not self._given:
            self.fresh = False
        self._arriving, self._expected = {}, None  # what has arrived is of the mission before
        self._look_at = []
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
            self._look_ahead(t, message)
        elif kind == "STATUSTEXT" and message.text.startswith("Flight plan received"):
            self.doubt(t)
        elif kind == "PARAM_VALUE" and message.param_id == "MIS_TOTAL":
            # ArduPilot sends it with every item that an upload adds or takes away.
            if message.param_value != len(self._items):
                self.doubt(t)
        elif kind == "MISSION_ACK" and message.mission_type == 0 and self._asking:
            if message.type == mavlink.MAV_MISSION_DENIED:
                self.doubt(t)  # somebody is uploading
            elif message.type != mavlink.MAV_MISSION_ACCEPTED:
                self._arriving, self._expected = {}, None  # the transfer is over; begin again
        elif kind == "MISSION_COUNT" and message.mission_type == 0 and message.count <= MOST_ITEMS:
            self._expected, self._arriving = message.count, {}
            self._progress(t)
        elif kind in ("MISSION_ITEM_INT", "MISSION_ITEM") and message.mission_type == 0:
            self._take(t, _item(message))

    def _take(self, t: float, item: MissionItem) -> None:
        known = self._items.get(item.seq)
        same = known is not None and known.command == item.command and same_numbers(known.params, item.params)
        reading = self._expected is not None
        if self.fresh and not same and not (self._given and reading):
            self.doubt(t)
        elif not reading:
            self._look_at = [seq for seq in self._look_at if seq != item.seq]
            self._looked_at = -math.inf
        elif item.seq < (self._expected or 0):
            self._arriving[item.seq] = item
            self._owes_ack = self._asking and len(self._arriving) == self._expected
            self._progress(t)

    def _progress(self, t: float) -> None:
        self._asked_at, self._attempts = t - RETRY_S, 0
        if self._expected is not None and len(self._arriving) == self._expected:
            self._items, self._arriving, self._expected = self._arriving, {}, None
            self._complete_at, self._changed_at = t, None
            self._given = False
            self.fresh = True

    def _look_ahead(self, t: float, message: Message) -> None:
        """Have another look at what runs when the present waypoint is reached, and at one item more."""
        moved, self._current = message.seq != self._current, message.seq
        has_identity = self._mission_id != 0
        if self._given or has_identity or not self.fresh or message.mission_state != MISSION_RUNS:
            return
        if moved or t - self._look_since >= LOOK_AGAIN_S:
            actions = [seq for seq, item in self._items.items() if not is_nav(item.command)]
            runs_next = self._run_next(message.seq)
            in_turn = sorted(actions, key=lambda seq: (seq <= self._in_turn, seq))[:1]
            self._in_turn = in_turn[0] if in_turn else 0
            self._look_since, self._look_at = t, [*runs_next, *in_turn]

    def _run_next(self, seq: int) -> list[int]:
        found = []
        while (item := self._items.get(seq + 1)) is not None and not is_nav(item.command):
            seq += 1
            found.append(seq)
        return found

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

    def requests(self, t: float, system_id: int, in_any_order: bool = False) -> list[Message]:
        """What to ask the autopilot next; at most one message a call.

        `in_any_order` says that it gives any item at any time, as ArduPilot does; PX4 ends the transfer where
        an item is neither the next nor the last one again, and tells the pilot.
        """
        if self._gave_up_at is not None and t - self._gave_up_at < TRY_AGAIN_S:
            return []
        if self.fresh and self._expected is None and self._changed_at is None:
            return self._look(t, system_id) if in_any_order else []
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
        here = self._current or 0 if in_any_order else 0
        missing = (seq for seq in range(self._expected) if seq not in self._arriving)
        first = min(missing, key=lambda seq: (seq < here, seq))  # what runs soon is needed first
        return [mavlink.MAVLink_mission_request_int_message(system_id, 1, first, 0)]

    def _look(self, t: float, system_id: int) -> list[Message]:
        if not self._look_at or t - self._looked_at < LOOK_RETRY_S:
            return []
        self._looked_at, self._asking = t, True
        return [mavlink.MAVLink_mission_request_int_message(system_id, 1, self._look_at[0], 0)]

    def acknowledgement(self, system_id: int) -> list[Message]:
        """The MISSION_ACK that ends a download that we asked for, once it is complete."""
        if not self._owes_ack:
            return []
        self._owes_ack = self._asking = False
        return [mavlink.MAVLink_mission_ack_message(system_id, 1, mavlink.MAV_MISSION_ACCEPTED, 0)]


def _item(message: Message) -> MissionItem:
    whole_numbers = message.get_type() == "MISSION_ITEM_INT"
    scale = 1e-7 if whole_numbers and has_place(message.command, message.frame) else 1.0
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
