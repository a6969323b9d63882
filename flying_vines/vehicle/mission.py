"""The mission's dictionary: which items the autopilot holds, read from it and kept true."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flying_vines.vehicle.codec import Message
from flying_vines.vehicle.mission_item import MissionItem

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


@dataclass(frozen=True, slots=True)
class Execution:
    """A mission item ran. `item` is None where only its number and kind are known."""

    command: int
    seq: int | None
    item: MissionItem | None
    params: tuple[float, ...] | None


ITEM_TEXT = re.compile(r"Mission: (\d+) (\S+)")
REACHED_TEXT = re.compile(r"Reached command #(\d+)")
COMMAND_OF_NAME = {
    "Scripting": 217,
    "Gripper": 211,
    "Winch": 42600,
    "NavScriptTime": 42702,
    "AuxFunction": 218,
    "SetRelay": 181,
    "SetServo": 183,
    "DigiCamCfg": 202,
    "DigiCamCtrl": 203,
    "WP": 16,
    "Takeoff": 22,
    "Land": 21,
    "Delay": 93,
}
"""What ArduPilot calls an item in its status text (AP_Mission, Mission_Command::type())."""

NAMED_COMMANDS = set(COMMAND_OF_NAME.values())

WAIT_FOR_BOOK_S = 2.5
WAIT_FOR_SCRIPT_S = 0.1
SAME_SCRIPT_ITEM_S = 0.5
"""A script on the autopilot was seen to hand an item's numbers over 5 to 17 ms after the item's text."""
SCRIPT_MESSAGE = 217
WAIT_FOR_TEXT_S = 1.0
PROGRESS_AFTER_REACHED_S = 3.0
"""MISSION_CURRENT comes at 1 Hz or faster: a later change is somebody's jump, not the waypoint's end."""
CONDITIONAL = {112, 113, 114, 115, 177, 600, 601}
"""CONDITION_* and jumps: items around them may not run although the mission moves on."""
LAST_NAV_COMMAND, NAV_SCRIPT_TIME = 95, 42702


class ArduPilotWatch:
    """Sees ArduPilot run mission items: by status text, and by mission progress where texts were lost.

    Each text is one execution (copies of a frame are dropped before). An item whose text never came counts as
    run when the waypoint before it was reached, the mission moved past it, frames were lost on the way, and
    nothing between is conditional. A script message that a script on the autopilot hands over as a command
    as well is one execution, whichever of the two comes first.
    """

    def __init__(self, book: MissionBook) -> None:
        self._book = book
        self._waiting: list[tuple[float, int, str]] = []
        self._told: dict[int, float] = {}
        self._reached: dict[int, float] = {}
        self._current: int | None = None
        self._last_sequence: int | None = None
        self._lost_at = -math.inf
        self._suspected: list[tuple[float, float, MissionItem]] = []
        self._run: list[tuple[float, tuple[float, ...]]] = []
        self._handed: list[tuple[float, tuple[float, ...]]] = []

    def handed_over(self, t: float, params: tuple[float, ...]) -> Execution | None:
        """A script message's numbers, from a script on the autopilot; None when that item has run already."""
        for entry in self._waiting:
            if entry[2] == "Scripting":
                self._waiting.remove(entry)
                return Execution(SCRIPT_MESSAGE, entry[1], None, params)
        if _take(self._run, t, params):
            return None
        self._handed.append((t, params))
        return Execution(SCRIPT_MESSAGE, None, None, params)

    def handle(self, t: float, message: Message) -> list[Execution]:
        kind = message.get_type()
        sequence = message.get_seq()
        if self._last_sequence is not None and sequence != (self._last_sequence + 1) & 0xFF:
            self._lost_at = t
        self._last_sequence = sequence
        if kind == "STATUSTEXT":
            if match := ITEM_TEXT.match(message.text):
                self._told[int(match[1])] = t
                self._waiting.append((t, int(match[1]), match[2]))
            elif match := REACHED_TEXT.match(message.text):
                self._reached[int(match[1])] = t
        elif kind == "MISSION_ITEM_REACHED":
            self._reached[message.seq] = t
        elif kind == "MISSION_CURRENT":
            self._suspect(t, message)
            self._current = message.seq
        return self.due(t)

    def _suspect(self, t: float, message: Message) -> None:
        before, now = self._current, message.seq
        if before is None or now <= before + 1 or not self._book.fresh:
            return
        reached_at = self._reached.get(before, -math.inf)
        if t - reached_at > PROGRESS_AFTER_REACHED_S:
            return
        passed: list[MissionItem] = []
        for seq in range(before + 1, now):
            item = self._book.items.get(seq)
            if item is None or item.command in CONDITIONAL:
                return
            if _is_nav(item.command):
                break  # nobody flew there, so what lies behind was jumped over
            passed.append(item)
        self._suspected.extend((t, reached_at, item) for item in passed)

    def due(self, t: float) -> list[Execution]:
        """The executions that are certain by now."""
        executions = []
        still: list[tuple[float, int, str]] = []
        for told_at, seq, name in self._waiting:
            item = self._book.items.get(seq)
            expected = COMMAND_OF_NAME.get(name)
            read_since = self._book.read_since(told_at)
            fits = item is not None and self._book.fresh and _fits(name, item.command, read_since)
            if item is not None and self._book.fresh and not fits and t == told_at:
                self._book.doubt(t)
            if name == "Scripting" and _take(self._handed, t, item.params if item and fits else None):
                continue
            if item is not None and fits:
                if item.command == SCRIPT_MESSAGE:
                    self._run.append((t, item.params))
                executions.append(Execution(item.command, seq, item, item.params))
            elif t - told_at < self._patience_s(name):
                still.append((told_at, seq, name))
            elif expected is not None:
                executions.append(Execution(expected, seq, None, None))
        self._waiting = still
        executions.extend(self._from_progress(t))
        return executions

    def _patience_s(self, name: str) -> float:
        """How long an item may wait for its numbers."""
        if self._book.items or self._book.arriving:
            return WAIT_FOR_BOOK_S
        return WAIT_FOR_SCRIPT_S if name == "Scripting" else 0.0

    def _from_progress(self, t: float) -> list[Execution]:
        due = [entry for entry in self._suspected if t - entry[0] >= WAIT_FOR_TEXT_S]
        if not due:
            return []
        self._suspected = [entry for entry in self._suspected if entry not in due]
        executions = []
        for _, reached_at, item in due:
            known = self._book.fresh and self._book.items.get(item.seq) == item
            untold = self._told.get(item.seq, -math.inf) < reached_at - 0.5
            if known and untold and self._lost_at >= reached_at - 0.5:
                self._told[item.seq] = t
                executions.append(Execution(item.command, item.seq, item, item.params))
        return executions


def _take(seen: list[tuple[float, tuple[float, ...]]], t: float, params: tuple[float, ...] | None) -> bool:
    """Whether these numbers (None: any) were seen just now; if so, they are used up."""
    seen[:] = [entry for entry in seen if t - entry[0] <= SAME_SCRIPT_ITEM_S]
    for entry in seen:
        if params is None or _same(entry[1][:4], params[:4]):
            seen.remove(entry)
            return True
    return False


def _is_nav(command: int) -> bool:
    return command <= LAST_NAV_COMMAND or command == NAV_SCRIPT_TIME


def _fits(name: str, command: int, read_since: bool) -> bool:
    """Whether the item that the book has is the one named; other releases may have other names."""
    expected = COMMAND_OF_NAME.get(name)
    if expected is None:
        return read_since or command not in NAMED_COMMANDS
    return expected == command


class Px4Watch:
    """Sees PX4 run mission items: it publishes them as COMMAND_LONG."""

    def __init__(self, book: MissionBook) -> None:
        self._book = book
        self._current = 0

    def handle(self, message: Message) -> None:
        if message.get_type() == "MISSION_CURRENT":
            self._current = message.seq

    def execution(self, command: int, params: tuple[float, ...]) -> Execution:
        """A command of the autopilot's, with the mission item that it comes from where that is known."""
        alike = [
            item
            for item in self._book.items.values()
            if item.command == command and _same(item.params[:4], params[:4])
        ]
        item = min(alike, key=lambda item: abs(item.seq - self._current), default=None)
        return Execution(command, item.seq if item else None, item, params)


def _same(a: Sequence[float], b: Sequence[float]) -> bool:
    """Equal as far as 32-bit floats and text files carry them."""
    return all(
        math.isclose(x, y, rel_tol=1e-5, abs_tol=1e-6) or (math.isnan(x) and math.isnan(y))
        for x, y in zip(a, b, strict=True)
    )


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
