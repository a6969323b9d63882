"""Seeing PX4 run mission items: it publishes them as COMMAND_LONG."""

from __future__ import annotations

from flying_vines.vehicle.codec import Message
from flying_vines.vehicle.mission.book import MissionBook
from flying_vines.vehicle.mission.execution import Execution, same_numbers


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
            if item.command == command and same_numbers(item.params[:4], params[:4])
        ]
        item = min(alike, key=lambda item: abs(item.seq - self._current), default=None)
        return Execution(command, item.seq if item else None, item, params)
