"""The flights of the log folder: their list as a page, and their files to download.

A name from a request becomes a path only if it looks like a flight's folder, so no other file can be read.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

FILES = ("flight.mcap", "flight.tlog")
MAX_LISTED = 500
_NAME = re.compile(r"\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d(_\d{1,3})?", re.ASCII)


class FlightFile(NamedTuple):
    """A file to download, as `flight` (the folder's name) and `name`."""

    flight: str
    name: str
    size_bytes: int


def listed(folder: Path) -> Iterator[FlightFile]:
    """The files of the latest flights, newest first. Raises `OSError` if the folder cannot be read."""
    flights = sorted((path.name for path in folder.iterdir() if _NAME.fullmatch(path.name)), reverse=True)
    for flight in flights[:MAX_LISTED]:
        for name in FILES:
            if path := file_of(folder, flight, name):
                yield FlightFile(flight, name, path.stat().st_size)


def file_of(folder: Path, flight: str, name: str) -> Path | None:
    """The file of a flight; None if there is none. Links to other places are not followed."""
    if not _NAME.fullmatch(flight) or name not in FILES:
        return None
    path = folder / flight / name
    linked = path.is_symlink() or path.parent.is_symlink()
    return None if linked or not path.is_file() else path


def page_of(files: Iterator[FlightFile]) -> str:
    """The list as HTML. The names have passed `_NAME` and need no escapes."""
    rows = "\n".join(
        f'<li><a href="flights/{flight}/{name}" download>{flight} {name}</a> {size_bytes / 1e6:.1f} MB</li>'
        for flight, name, size_bytes in files
    )
    return _PAGE.format(rows=rows or "<li>No flights yet</li>")


_PAGE = """\
<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark"><title>Flights</title><link rel="stylesheet" href="style.css">
<body class="watching"><header><h1>Flights</h1><a href="./">Back to the vine</a></header>
<main><section><ol class="flights">
{rows}
</ol></section></main>
</html>
"""
