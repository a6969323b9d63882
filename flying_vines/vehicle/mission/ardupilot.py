"""Seeing ArduPilot run mission items: by its status texts, and by mission progress where those were lost."""

from __future__ import annotations

import math
import re

from flying_vines.vehicle.codec import Message
from flying_vines.vehicle.mission.book import MissionBook
from flying_vines.vehicle.mission.execution import Execution, same_numbers
from flying_vines.vehicle.mission.item import MissionItem, is_nav

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
            if is_nav(item.command):
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
        if params is None or same_numbers(entry[1][:4], params[:4]):
            seen.remove(entry)
            return True
    return False


def _fits(name: str, command: int, read_since: bool) -> bool:
    """Whether the item that the book has is the one named; other releases may have other names."""
    expected = COMMAND_OF_NAME.get(name)
    if expected is None:
        return read_since or command not in NAMED_COMMANDS
    return expected == command
