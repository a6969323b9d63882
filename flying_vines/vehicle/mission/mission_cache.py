"""The mission items that the autopilot holds, read from it and kept up to date."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.mavlink.codec import MavlinkMessage
from flying_vines.vehicle.mission.item import MissionItem, has_place, is_nav, same_numbers

RETRY_S = 0.8
MAX_ATTEMPTS = 6
TRY_AGAIN_S = 20.0
QUIET_BEFORE_READING_S = 0.5
"""The number of items changes during an upload. Reading waits until it is stable for this time."""
SAME_CHANGE_S = 5.0
"""If the mission was read within this time, a new total that agrees with the items read is not a change."""
MAX_ITEMS = 5000


class ItemRequest(mavlink.MAVLink_mission_request_int_message):  # type: ignore[misc]
    """MISSION_REQUEST_INT for an item that ran and whose params must be confirmed."""


class MissionCache:
    """Reads the mission (MAVLink mission protocol, download side), again after each change.

    It also reads downloads that another component requested. So a recording of a companion's link fills the
    cache although no autopilot answers our requests.

    ArduPilot may have no mission id. Then no message shows that the mission was replaced by another one of
    the same length. So each item that runs is requested again (`ask`), unless the mission `is_given`.
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
        self._read_id = self._arriving_id = 0
        self._change_reported = self._has_changed = False
        self.fresh = bool(items)

    @property
    def arriving(self) -> bool:
        """True while the autopilot sends its mission."""
        return self._expected is not None

    @property
    def items(self) -> Mapping[int, MissionItem]:
        return self._items

    @property
    def is_given(self) -> bool:
        """True if the mission was given at the start, and none has been read since."""
        return self._given

    @property
    def is_certain(self) -> bool:
        """True if the cache certainly holds the autopilot's present mission."""
        return self._given or (self.fresh and self._read_id != 0 and self._read_id == self._mission_id)

    def alike(self, command: int, params: Sequence[float]) -> list[MissionItem]:
        """The items with this command and these first four params."""
        return [
            item
            for item in self._items.values()
            if item.command == command and same_numbers(item.params[:4], params[:4])
        ]

    def only(self, command: int, params: Sequence[float]) -> MissionItem | None:
        """The only item with this command and these params; None if there is none, or more than one."""
        alike = self.alike(command, params)
        return alike[0] if len(alike) == 1 else None

    def take_change(self) -> bool:
        """True, once, after a different mission was read, if the pilot does not know it yet."""
        changed, self._has_changed = self._has_changed, False
        return changed

    def note_change_reported(self) -> None:
        """The pilot has been informed that the mission changed."""
        self._change_reported = True

    def mark_outdated(self, t: float) -> None:
        """The mission has probably changed: do not trust the cache, read it again."""
        if not self._given:
            self.fresh = False
        self._arriving, self._expected = {}, None  # these items are of the previous mission
        self._changed_at = t
        self._attempts = 0
        self._gave_up_at = None

    def refresh(self, t: float) -> None:
        """Read the mission again, because not every change is announced. Trust the cache until then."""
        self._changed_at = t
        self._attempts = 0
        self._gave_up_at = None

    def handle(self, t: float, message: MavlinkMessage) -> None:
        """Take in a message of our autopilot."""
        kind = message.get_type()
        if kind == "MISSION_CURRENT":
            self._current = message.seq
            self._watch_for_change(t, message)
        elif kind == "STATUSTEXT" and message.text.startswith("Flight plan received"):
            self.mark_outdated(t)
        elif kind == "PARAM_VALUE" and message.param_id == "MIS_TOTAL":
            # ArduPilot sends it with every item that an upload adds or removes.
            if message.param_value != len(self._items):
                self.mark_outdated(t)
        elif kind == "MISSION_ACK" and message.mission_type == 0 and self._asking:
            if message.type == mavlink.MAV_MISSION_DENIED:
                self.mark_outdated(t)  # somebody is uploading
            elif message.type != mavlink.MAV_MISSION_ACCEPTED:
                self._arriving, self._expected = {}, None  # the transfer was cancelled; begin again
        elif kind == "MISSION_COUNT" and message.mission_type == 0 and message.count <= MAX_ITEMS:
            self._expected, self._arriving = message.count, {}
            self._arriving_id = _mission_id(message, 5) or self._mission_id or 0
            self._progress(t)
        elif kind in ("MISSION_ITEM_INT", "MISSION_ITEM") and message.mission_type == 0:
            self._take(t, item_of(message))

    def _take(self, t: float, item: MissionItem) -> None:
        known = self._items.get(item.seq)
        same = known is not None and known.command == item.command and same_numbers(known.params, item.params)
        reading = self._expected is not None
        if self.fresh and not same and not (self._given and reading):
            self.mark_outdated(t)
        elif reading and item.seq < (self._expected or 0):
            self._arriving[item.seq] = item
            self._progress(t)

    def _progress(self, t: float) -> None:
        self._asked_at, self._attempts = t - RETRY_S, 0
        if self._expected is None or len(self._arriving) < self._expected:
            return
        self._has_changed = bool(self._items) and not self._change_reported and self._actions_differ()
        self._items, self._arriving, self._expected = self._arriving, {}, None
        self._complete_at, self._changed_at = t, None
        self._read_id = self._arriving_id
        self._given = self._change_reported = False
        self.fresh = True
        self._owes_ack = self._asking

    def _actions_differ(self) -> bool:
        """True if the arriving mission has other actions. Waypoints and home (item 0) do not count."""
        before, now = (
            {seq: (item.command, *item.params) for seq, item in items.items() if not is_nav(item.command)}
            for items in (self._items, self._arriving)
        )
        return before.keys() != now.keys() or any(not same_numbers(before[seq], now[seq]) for seq in now)

    def _watch_for_change(self, t: float, message: MavlinkMessage) -> None:
        total, mission_id = message.total, _mission_id(message, 6)
        first = self._total is None
        if first or (total, mission_id) == (self._total, self._mission_id):
            self._total, self._mission_id = total, mission_id
            if first and mission_id and self._complete_at is not None and mission_id != self._read_id:
                self.refresh(t)  # the mission was read before its id was known
            return
        same_id = mission_id == self._mission_id
        self._total, self._mission_id = total, mission_id
        just_read = self._complete_at is not None and t - self._complete_at < SAME_CHANGE_S
        if just_read and same_id and total == len(self._items) - 1:
            return  # ArduPilot's total leaves out the home item, and its mission has no id
        self.mark_outdated(t)

    def requests(self, t: float, system_id: int, in_any_order: bool = False) -> list[MavlinkMessage]:
        """The next request to the autopilot; at most one message per call.

        `in_any_order`: the autopilot sends any item at any time, like ArduPilot. PX4 ends the transfer with a
        text to the pilot, unless the request is for the next item or the previous one again.
        """
        if self._gave_up_at is not None and t - self._gave_up_at < TRY_AGAIN_S:
            return []
        if self.fresh and self._expected is None and self._changed_at is None:
            return []
        if self._changed_at is not None and t - self._changed_at < QUIET_BEFORE_READING_S:
            return []
        if t - self._asked_at < RETRY_S:
            return []
        if self._attempts >= MAX_ATTEMPTS:
            self._gave_up_at, self._attempts, self._expected = t, 0, None
            return []
        self._asked_at, self._asking = t, True
        self._attempts += 1
        if self._expected is None:
            return [mavlink.MAVLink_mission_request_list_message(system_id, 1, 0)]
        here = self._current or 0 if in_any_order else 0
        missing = (seq for seq in range(self._expected) if seq not in self._arriving)
        first = min(missing, key=lambda seq: (seq < here, seq))  # items that run soon come first
        return [mavlink.MAVLink_mission_request_int_message(system_id, 1, first, 0)]

    def ask(self, seq: int, system_id: int) -> MavlinkMessage:
        """The request for one item. ArduPilot answers it at any time."""
        self._asking = True
        return ItemRequest(system_id, 1, seq, 0)

    def acknowledgement(self, system_id: int) -> list[MavlinkMessage]:
        """The MISSION_ACK that ends a complete download that we requested."""
        if not self._owes_ack:
            return []
        self._owes_ack = self._asking = False
        return [mavlink.MAVLink_mission_ack_message(system_id, 1, mavlink.MAV_MISSION_ACCEPTED, 0)]


def item_of(message: MavlinkMessage) -> MissionItem:
    """The item in a MISSION_ITEM_INT or MISSION_ITEM."""
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


def _mission_id(message: MavlinkMessage, at: int) -> int:
    """PX4's checksum of the mission, an extension field of MISSION_CURRENT and MISSION_COUNT.

    The dialect lacks it. `at` is its position in the payload.
    """
    frame = message.get_msgbuf()
    if not frame or frame[0] != 0xFD:
        return 0
    payload = bytes(frame[10 : 10 + frame[1]])
    return int.from_bytes(payload[at : at + 4], "little")
