"""The flight recorder: a folder per flight, with all inputs and outputs of the core.

The service's loop only appends to a list. A thread of the recorder encodes the entries as JSON and writes
them to the disk. A disk that fails, is full or was removed interrupts the log. A disk that hangs ends the
log. Neither affects the flight.
"""

from __future__ import annotations

import time
from pathlib import Path

from flying_vines.core.events import Action, Event
from flying_vines.core.snapshot import Snapshot
from flying_vines.core.watcher import Watcher
from flying_vines.files.background_writer import BackgroundWriter
from flying_vines.record.folders import FlightStart, Folders
from flying_vines.record.topics import RawEntry, entry_of_action, entry_of_event, entry_of_state

__all__ = ["FlightStart", "Recorder"]

HAND_OVER_S = 0.1
"""Entries wait this long in the list. Then the thread gets them as one batch. A batch is small, so that the
thread's work on it delays the loop only a little."""
MAX_WAITING = 150_000
"""Maximum number of entries in the queue while the disk hangs: about six minutes of flight, 32 MB."""
LAST_WRITES_S = 5.0


class Recorder(Watcher):
    """Records from the start of the service to its end."""

    def __init__(
        self, parent: Path, began: FlightStart, least_free_MB: float = 0.0, t: float | None = None
    ) -> None:
        """`t`: the present time by the service's clock; default: the monotonic clock.

        Raises `OSError` if `parent` cannot be written.
        """
        self._folders = Folders(parent, began, least_free_MB, time.monotonic() if t is None else t)
        self._writer: BackgroundWriter[list[RawEntry | None]] = BackgroundWriter(
            self._folders.write, MAX_WAITING
        )
        self._waiting: list[RawEntry | None] = []
        self._due = 0.0
        self._t = 0.0
        self._armings = _Armings()
        self._ended = ""

    @property
    def folder(self) -> Path:
        return self._folders.folder

    @property
    def failed(self) -> str:
        """A sentence for people while nothing is written; else empty."""
        if self._over:
            return self._over
        problem = self._folders.problem
        return f"the flight log ends here: {problem}" if problem else ""

    @property
    def news(self) -> str:
        """A sentence to show whenever it changes: why the log ended, or where it continues."""
        folder = self._folders.continued_in
        return self.failed or (f"the flight log continues in {folder}" if folder else "")

    @property
    def _over(self) -> str:
        """Why nothing more will be written."""
        error = self._writer.error
        return f"the flight log ends here: {error.strerror}" if error else self._ended

    def event(self, event: Event) -> None:
        self._t = event.t
        self._take(entry_of_event(event))

    def action(self, action: Action) -> None:
        entry = entry_of_action(self._t, action)
        if entry is not None:
            self._take(entry)

    def snapshot(self, snapshot: Snapshot) -> None:
        if self._armings.starts_flight(snapshot.armed):
            self._waiting.append(None)
        self._take(entry_of_state(snapshot))

    def close(self) -> None:
        """Write the remaining entries within `LAST_WRITES_S`."""
        self._hand_over()
        if not self._writer.close(LAST_WRITES_S):
            self._ended = "the end of the flight log is lost: the disk hangs"
            return
        try:
            self._folders.close(whole=not self.failed)
        except OSError as error:
            self._ended = f"the flight log ends here: {error.strerror}"

    def _take(self, entry: RawEntry) -> None:
        self._waiting.append(entry)
        if entry[1] >= self._due:
            self._due = entry[1] + HAND_OVER_S
            self._hand_over()

    def _hand_over(self) -> None:
        waiting, self._waiting = self._waiting, []
        if waiting and not self._over and not self._writer.write(waiting, len(waiting)):
            self._ended = "the flight log ends here: the disk does not keep up"


class _Armings:
    """Detects a second arming, which starts another flight."""

    def __init__(self) -> None:
        self._armed = self._has_flown = False

    def starts_flight(self, armed: bool) -> bool:
        """True if this snapshot starts another flight after a first one."""
        began, ended = armed and not self._armed, self._armed and not armed
        self._armed = armed
        starts = began and self._has_flown
        self._has_flown = (self._has_flown or ended) and not starts
        return starts
