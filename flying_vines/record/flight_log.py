"""The flight log: one folder per flight, one JSON object a line, readable up to the last whole line."""

from __future__ import annotations

import contextlib
import json
import math
import os
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from flying_vines.config import Pneumatics
from flying_vines.events import Action, Calibrated, Decision, KeepParameters, Measured, Snapshot
from flying_vines.notice import Notice
from flying_vines.record.aside import Aside
from flying_vines.reservoir import nominal_rig

NAME = "flight.jsonl"
FLUSH_S = 0.5
"""How much of a flight may be lost when the power goes: so often lines are put on the disk for good."""
MOST_BEHIND = 32 * 1024 * 1024
"""Characters: of a disk that hangs, twenty minutes of telemetry at 100 Hz."""
LAST_WRITES_S = 5.0


class FlightLog:
    """Writes what happens in a flight. A disk that fails or hangs ends the log, never the flight."""

    def __init__(self, parent: Path, began: float | None = None) -> None:
        """Raises `OSError` when the folder cannot be made."""
        stamp = time.strftime("%Y-%m-%d_%H-%M-%S", time.localtime(began))
        self.folder = _new_folder(parent, stamp)
        self.path = self.folder / NAME
        self._file = self.path.open("w", encoding="utf-8")
        self._aside = Aside(self._put_on_disk, MOST_BEHIND)
        self._lines: list[str] = []
        self._handed_over_at = -math.inf
        self._ended = ""

    @property
    def failed(self) -> str:
        """A sentence for people, once the log has ended before its time."""
        error = self._aside.error
        return f"the flight log ends here: {error.strerror}" if error else self._ended

    def action(self, action: Action) -> None:
        """Log what people want to read of an action; messages on the wire are not logged here."""
        if isinstance(action, Decision):
            self._write("decision", asdict(action))
        elif isinstance(action, Notice):
            self._write("notice", asdict(action))
        elif isinstance(action, Measured):
            self._write("telemetry", {"t": action.t, **asdict(action.telemetry)})
        elif isinstance(action, Calibrated):
            self._write("calibration", asdict(action))
        elif isinstance(action, KeepParameters):
            self._write("parameters", asdict(action))

    def believed(self, t: float, numbers: Pneumatics) -> None:
        """What the rig is believed to be, as the tables of a rig file."""
        self._write("rig", {"t": t, "tables": asdict(nominal_rig(numbers))})

    def snapshot(self, snapshot: Snapshot) -> None:
        self._write("snapshot", asdict(snapshot))

    def close(self) -> None:
        """Write the rest, for as long as that may take."""
        self._hand_over()
        if not self._aside.close(LAST_WRITES_S):
            self._ended = "the end of the flight log is lost: the disk hangs"
            return
        # What could not be written comes again here.
        with contextlib.suppress(OSError):
            self._file.close()

    def _write(self, kind: str, fields: dict[str, Any]) -> None:
        if self.failed:
            return
        self._lines.append(json.dumps({"kind": kind, **_finite(fields)}, separators=(",", ":")) + "\n")
        if fields["t"] - self._handed_over_at > FLUSH_S:
            self._handed_over_at = fields["t"]
            self._hand_over()

    def _hand_over(self) -> None:
        if self._lines and not self._aside.write("".join(self._lines)):
            self._ended = "the flight log ends here: the disk does not keep up"
        self._lines.clear()

    def _put_on_disk(self, text: str) -> None:
        self._file.write(text)
        self._file.flush()
        os.fsync(self._file.fileno())


def read_log(path: Path) -> Iterator[dict[str, Any]]:
    """The entries of a log, over damaged lines."""
    with path.open(encoding="utf-8", errors="replace") as file:
        for line in file:
            try:
                entry = json.loads(line)
            except json.JSONDecodeError:
                continue
            if isinstance(entry, dict):
                yield entry


def _finite(value: Any) -> Any:
    """JSON has no NaN: unknown is null."""
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float):
        return round(value, 4) if math.isfinite(value) else None
    return value


def _new_folder(parent: Path, stamp: str) -> Path:
    for suffix in ("", *(f"_{n}" for n in range(2, 1000))):
        folder = parent / (stamp + suffix)
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        return folder
    raise FileExistsError(f"{parent}: a thousand flights in one second")
