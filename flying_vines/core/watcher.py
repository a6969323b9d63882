"""Observers of the core: a recorder, a display, the gateway to a page and a broker."""

from __future__ import annotations

from collections.abc import Callable

from flying_vines.core.events import Action, Event
from flying_vines.core.snapshot import Snapshot


class Watcher:
    """Called in the service's loop, up to a tick after the core. A watcher must return soon and never raise.

    Calls come in the core's order: each event, then its actions. Override the methods that you need.
    """

    def event(self, event: Event) -> None:
        """An event was handled."""

    def action(self, action: Action) -> None:
        """One action of the latest event. A MAVLink message in an action is already packed."""

    def snapshot(self, snapshot: Snapshot) -> None:
        """The state, about ten times a second."""


class EachAction(Watcher):
    """Passes on only the actions."""

    def __init__(self, take: Callable[[Action], None]) -> None:
        self._take = take

    def action(self, action: Action) -> None:
        self._take(action)
