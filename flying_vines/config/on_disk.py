"""Atomic writes of small files: after a power cut there is the old file or the new one, never a part."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import mkstemp


def put(path: Path, text: str) -> None:
    """Write to a temporary file, sync it to the disk, and then replace `path` with it.

    Creates a missing folder. Raises `OSError` if a step fails; then `path` is unchanged, unless only the sync
    of its folder failed.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    number, temporary = mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(number, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fchmod(number, 0o644)
            os.fsync(number)
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def take_away(path: Path) -> None:
    """Remove the file, if it exists, so that it stays removed after a power cut. Raises `OSError`."""
    try:
        path.unlink()
    except FileNotFoundError:
        return
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Make new and removed entries of the folder survive a power cut."""
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)
