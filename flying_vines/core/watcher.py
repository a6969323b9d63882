"""Whoever looks on while the service serves: a recorder, a display, the gateway to a page and a broker."""

from __future__ import annotations

from collections.abc import Callable

from flying_vines.core.events import Action, Event, Snapshot


class Watcher:
    """Called in the loop that flies, some milliseconds after what it sees: returns soon, and never raises.

    The order is that of the core: each event, then what came of it. Override what is to be seen.
    """

    def event(self, event: Event) -> None:
        """Something happened."""

    def action(self, action: Action) -> None:
        """The core's answer to the latest event, or a part of it. Messages are packed by now."""

    def snapshot(self, snapshot: Snapshot) -> None:
        """How things stand, some ten times a second."""


class EachAction(Watcher):
    """Hands on what the core does, and nothing else."""

    def __init__(self, take: Callable[[Action], None]) -> None:
        self._take = take

    def action(self, action: Action) -> None:
        self._take(action)
