"""Seeing PX4 run mission items: it publishes them as COMMAND_LONG."""

from __future__ import annotations

import math

from flying_vines.vehicle.codec import Message
from flying_vines.vehicle.mission.book import MissionBook
from flying_vines.vehicle.mission.execution import Execution, same_numbers
from flying_vines.vehicle.mission.item import is_nav
from flying_vines.vehicle.repeats import LATE_S

MOST_BEFORE_A_REPEAT_S = 0.5
"""The first repeat comes half a second or, at times, a second after its item, and may be late itself."""
BEFORE_A_REPEAT_S = 0.4
"""Half a second at least lies between an item and its first repeat, less what a link takes: what ran since
then ran later."""
SAME_BURST_S = 3.0
"""The last repeat of an item comes two seconds after it, the items behind it within milliseconds."""


class Px4Watch:
    """Sees PX4 run mission items: it publishes them as COMMAND_LONG."""

    def __init__(self, book: MissionBook) -> None:
        self._book = book
        self._current = 0
        self._ran: Execution | None = None
        self._ran_at = 0.0
        self._forgotten_at = -math.inf

    def forget(self, t: float) -> None:
        """What ran before now is history, and is not carried out when only a repeat of it is heard: we had
        not begun to listen, or a person has asked for something since."""
        self._forgotten_at = t

    def handle(self, message: Message) -> None:
        if message.get_type() == "MISSION_CURRENT":
            self._current = message.seq

    def execution(
        self, t: float, command: int, params: tuple[float, ...], confirmation: int
    ) -> Execution | None:
        """A command of the autopilot's, with the mission item that it comes from where that is known.

        None for a repeat whose first frames were lost, of an item that is history: a later one has run
        already, or see `forget`.
        """
        item = self._book.nearest(command, params, self._current)
        execution = Execution(command, item.seq if item else None, item, params)
        begun_at_soonest = t - (confirmation + 1) * MOST_BEFORE_A_REPEAT_S - LATE_S
        if confirmation and (begun_at_soonest < self._forgotten_at or self._overtaken(t, execution)):
            return None
        self._ran, self._ran_at = execution, t
        return execution

    def _overtaken(self, t: float, execution: Execution) -> bool:
        ran = self._ran
        if ran is None or _same(ran, execution):
            return False
        if t - self._ran_at < BEFORE_A_REPEAT_S:
            return True
        if ran.seq is None or execution.seq is None or t - self._ran_at > SAME_BURST_S:
            return False
        between = [self._book.items[seq] for seq in range(execution.seq, ran.seq) if seq in self._book.items]
        return ran.seq > execution.seq and not any(is_nav(item.command) for item in between)


def _same(a: Execution, b: Execution) -> bool:
    return a.command == b.command and same_numbers(a.params or (), b.params or ())
