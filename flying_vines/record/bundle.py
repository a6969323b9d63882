"""One flight in one zip file, for a bug report. It never contains keys."""

from __future__ import annotations

import shutil
import time
import zipfile
from pathlib import Path

import msgspec

from flying_vines.record.flight_metadata import ABOUT, FlightMetadata
from flying_vines.record.folders import CONFIGURATION, MCAP, RIG, TLOG
from flying_vines.record.reader import FlightLog

PARTS = (MCAP, TLOG, CONFIGURATION, RIG, ABOUT)
"""Only these files, because a person may have put anything else into the folder."""


def bundle(log: FlightLog, events: str, path: Path) -> list[str]:
    """Write a zip file about the flight and this machine. Returns the names in it.

    `events` is the flight as text, as `log show` prints it.
    """
    names = []
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name in PARTS:
            part = log.folder / name
            if part.is_file():
                file.write(part, f"{log.folder.name}/{name}")
                names.append(name)
        for name, text in (("story.txt", events), ("this-machine.json", _this_machine(log.folder))):
            file.writestr(f"{log.folder.name}/{name}", text)
            names.append(name)
    return names


def _this_machine(folder: Path) -> str:
    """The machine that made the bundle. The flight may have been recorded on another."""
    disk = shutil.disk_usage(folder)
    facts = {
        **msgspec.to_builtins(FlightMetadata.of_this_machine(0, time.time(), "")),
        "disk_free_MB": round(disk.free / 1e6),
        "disk_total_MB": round(disk.total / 1e6),
    }
    del facts["number"], facts["continues"], facts["firmware"]
    return msgspec.json.format(msgspec.json.encode(facts), indent=2).decode() + "\n"
