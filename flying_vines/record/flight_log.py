"""The flight log: one folder per flight, one JSON object a line, readable up to the last whole line."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any, TextIO

from flying_vines.config import Pneumatics
from flying_vines.events import Action, Calibrated, Decision, KeepParameters, Measured, Snapshot
from flying_vines.notice import Notice
from flying_vines.reservoir import nominal_rig

NAME = "flight.jsonl"
FLUSH_S = 0.5


class FlightLog:
    """Writes what happens in a flight. A disk that fails ends the log, never the flight."""

    def __init__(self, parent: Path, began: float | None = None) -> None:
        """Raises `OSError` when the folder cannot be made."""
        stamp = time.strftime("%Y-%m-%d_%H-%M-%S", time.localtime(began))
        self.folder = _new_folder(parent, stamp)
        self.path = self.folder / NAME
        self.failed = ""
        self._file: TextIO | None = self.path.open("w", encoding="utf-8")
        self._flushed_at = -math.inf

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

    def _write(self, kind: str, fields: dict[str, Any]) -> None:
        if self._file is None:
            return
        try:
            # In one go, for it comes up to a thousand times a second.
            self._file.write(json.dumps({"kind": kind, **_finite(fields)}, separators=(",", ":")) + "\n")
            if fields["t"] - self._flushed_at > FLUSH_S:
                self._file.flush()
                self._flushed_at = fields["t"]
        except OSError as error:
            self.failed = f"the flight log ends here: {error.strerror}"
            self.close()

    def close(self) -> None:
        file, self._file = self._file, None
        if file is not None:
            try:
                file.close()
            except OSError as error:
                self.failed = f"the end of the flight log is lost: {error.strerror}"


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
