"""Seeing PX4 run mission items: it publishes them as COMMAND_LONG, and tells that they were reached."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Container
from dataclasses import dataclass, replace

from flying_vines.vehicle.autopilots.autopilot import MissionWatch
from flying_vines.vehicle.clock import AutopilotClock, Mark
from flying_vines.vehicle.mavlink.codec import Message
from flying_vines.vehicle.mission.book import MissionBook
from flying_vines.vehicle.mission.execution import Execution, same_numbers
from flying_vines.vehicle.mission.item import MissionItem, is_nav
from flying_vines.vehicle.repeats import LATE_S, PX4_REPEAT_S

SHORTEST_REPEAT_S = 0.5
"""The first repeat comes half a second or, at times, a second after its item, and may be late itself."""
FIRST_REPEAT_LATER_S = 0.25
"""The first repeat comes 0.5 or 1 s after the item: half the difference. A third copy is over 1 s old."""
BEFORE_A_REPEAT_S = 0.4
"""Half a second at least lies between an item and its first repeat, less what a link takes: what ran since
then ran later."""
SAME_BURST_S = 3.0
"""The last repeat of an item comes two seconds after it, the items behind it within milliseconds."""

WAIT_FOR_COMMAND_S = 0.3
"""MISSION_ITEM_REACHED was seen up to 20 ms after its command, and once before it."""
LAST_REPEAT_S = 2.5
"""So long a command may still come, which has numbers of its own."""
REACHED_WITHIN_S = 3.0
"""It is repeated each second."""
GRIPPER, WINCH = 211, 42600
TIMEOUT_S = 60.0
"""For a gripper and a winch PX4 waits for MIS_COMMAND_TOUT before it tells that they were reached."""
REPEATED_WITHIN_S = 2.5
"""What is told as reached this shortly after it was is the same again, overtaken by another."""
MOST_PAST = 8
HISTORY_S = 2.0
"""What is told this soon after we began to listen may be a repeat."""


@dataclass(slots=True)
class _Ran:
    t: float
    execution: Execution
    was_reached: bool


@dataclass(slots=True)
class _Reached:
    """A vine item that was reached, and whose command has not come."""

    item: MissionItem
    mark: Mark
    late_s: float
    """How much later than the item the mark may be."""


class Px4Watch(MissionWatch):
    """Sees PX4 run mission items: those it publishes as COMMAND_LONG, with the numbers that it executes.

    One whose command was lost shows as MISSION_ITEM_REACHED, and has the numbers of the book, if that is
    known to be of the mission that runs. Of several items at one place only the last is told as reached.
    """

    def __init__(
        self, book: MissionBook, commands: Container[int] = (), clock: AutopilotClock | None = None
    ) -> None:
        self._book = book
        self._commands = commands
        self._clock = clock or AutopilotClock()
        self._current = 0
        self._past: deque[_Ran] = deque(maxlen=MOST_PAST)
        self._forgotten_at = -math.inf
        self._begun_at: float | None = None
        self._reached: int | None = None
        self._reached_at: dict[int, float] = {}
        self._waiting: _Reached | None = None
        self._made_up: Execution | None = None
        self._made_up_at = -math.inf
        self._stood_at = 0.0
        self._has_moved = False

    def forget(self, t: float) -> None:
        """Of an item that ran before now a repeat is not carried out."""
        self._forgotten_at = t
        self._waiting = None

    def handle(self, t: float, message: Message) -> None:
        kind = message.get_type()
        if self._begun_at is None:
            self._begun_at = self._stood_at = t
        if kind == "MISSION_CURRENT":
            self._has_moved = self._has_moved or message.seq != self._current
            if not self._has_moved:
                self._stood_at = t  # so nothing ran before now that we do not know of
            self._current = message.seq
        elif kind == "MISSION_ITEM_REACHED":
            self._reach(t, message.seq)

    def _reach(self, t: float, seq: int) -> None:
        known, self._reached = self._reached, seq
        lost = self._clock.lost_at > self._stood_at
        late_s = t - self._stood_at if lost else 0.0
        self._stood_at, self._has_moved = t, False
        again = seq == known or t - self._reached_at.pop(seq, -math.inf) < REPEATED_WITHIN_S
        self._reached_at[seq] = t
        if len(self._reached_at) > MOST_PAST:
            del self._reached_at[next(iter(self._reached_at))]
        item = self._book.items.get(seq) if self._book.fresh else None
        if item is None or item.command not in self._commands:
            return
        if again or (known is None and t - (self._begun_at or 0.0) < HISTORY_S):
            return
        if not self._has_run(t, item) and not self._ran_later(t, item):
            self._waiting = _Reached(item, self._clock.mark(t), late_s)

    def _has_run(self, t: float, item: MissionItem) -> bool:
        """Whether its command has come; each command is one item's."""
        within_s = TIMEOUT_S if item.command in (GRIPPER, WINCH) else REACHED_WITHIN_S
        for ran in reversed(self._past):
            fits = ran.execution.seq in (None, item.seq) and _same(ran.execution, _of(item))
            if fits and not ran.was_reached and t - ran.t < within_s:
                ran.was_reached = True
                return True
        return False

    def _ran_later(self, t: float, item: MissionItem) -> bool:
        """Whether an item behind it has run already, at the same place."""
        return any(
            other.seq > item.seq and not self._flies_between(item.seq, other.seq)
            for ran in self._past
            if t - ran.t < REACHED_WITHIN_S
            for other in self._book.alike(ran.execution.command, ran.execution.params or ())
        )

    def command(
        self, t: float, command: int, params: tuple[float, ...], confirmation: int
    ) -> Execution | None:
        """A command of the autopilot's, with the mission item that it comes from where that is known.

        None for a repeat whose first frames were lost, of an item that is history: a later one has run
        already, or see `forget`. And for a command that comes after its item was made up for.
        """
        item = self._book.only(command, params) if self._book.is_running else None
        age_s = confirmation * SHORTEST_REPEAT_S + (FIRST_REPEAT_LATER_S if confirmation else 0.0)
        execution = Execution(command, item.seq if item else None, item, params, age_s)
        made_up_s = (confirmation + 1) * PX4_REPEAT_S + LATE_S
        if self._made_up and t - self._made_up_at < made_up_s and _same(self._made_up, execution):
            return None
        begun_at_soonest = t - (confirmation + 1) * SHORTEST_REPEAT_S - LATE_S
        if confirmation and (begun_at_soonest < self._forgotten_at or self._overtaken(t, execution)):
            return None
        was_reached = False
        if self._waiting and _same(_of(self._waiting.item), execution):
            execution = replace(execution, seq=self._waiting.item.seq, item=self._waiting.item)
            was_reached = True
        if was_reached or confirmation == 0:
            self._waiting = None
        self._past.append(_Ran(t, execution, was_reached))
        return execution

    @property
    def idle(self) -> bool:
        return self._waiting is None

    def due(self, t: float) -> list[Execution]:
        """An item whose command was lost, once that is certain."""
        waiting = self._waiting
        wait_s = WAIT_FOR_COMMAND_S if self._book.is_running else LAST_REPEAT_S
        if waiting is None or t - waiting.mark.t < wait_s:
            return []
        age_s = self._clock.age_s(waiting.mark, t)
        if age_s is None:
            return []
        self._waiting = None
        item = waiting.item
        if self._book.items.get(item.seq) != item:
            return []
        execution = replace(_of(item), age_s=age_s + waiting.late_s)
        if not self._book.is_running:
            return [replace(execution, item=None, params=None)]
        self._made_up, self._made_up_at = execution, t
        self._past.append(_Ran(t, execution, True))
        return [execution]

    def _overtaken(self, t: float, execution: Execution) -> bool:
        if not self._past or _same(self._past[-1].execution, execution):
            return False
        ran = self._past[-1]
        if t - ran.t < BEFORE_A_REPEAT_S:
            return True
        seq, ran_seq = (self._nearest(one) for one in (execution, ran.execution))
        if seq is None or ran_seq is None or t - ran.t > SAME_BURST_S:
            return False
        return ran_seq > seq and not self._flies_between(seq, ran_seq)

    def _nearest(self, execution: Execution) -> int | None:
        """Of the items that it may be the one nearest to where the mission is, and of two the one ahead."""
        if execution.seq is not None:
            return execution.seq
        seqs = [item.seq for item in self._book.alike(execution.command, execution.params or ())]
        return min(seqs, key=lambda seq: (abs(seq - self._current), -seq), default=None)

    def _flies_between(self, first: int, last: int) -> bool:
        items = self._book.items
        return any(is_nav(items[seq].command) for seq in range(first, last) if seq in items)


def _of(item: MissionItem) -> Execution:
    return Execution(item.command, item.seq, item, item.params)


def _same(a: Execution, b: Execution) -> bool:
    # Between them stand a place's whole numbers in an item, and any numbers in a command.
    one, other = ((*params[:4], *params[6:]) for params in (a.params or (), b.params or ()))
    return a.command == b.command and len(one) == len(other) and same_numbers(one, other)
