"""Small files that outlive a power cut: after it there is the old one or the new one, never half of it."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import mkstemp


def put(path: Path, text: str) -> None:
    """Write beside the file, and let it take the file's place only when it is safe on the disk.

    Makes the folder where there is none. `OSError` where any of it fails; then the old file is still there.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    number, beside = mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(number, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fchmod(number, 0o644)
            os.fsync(number)
        Path(beside).replace(path)
    except BaseException:
        Path(beside).unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def take_away(path: Path) -> None:
    """For good; nothing where there is none. `OSError` where that fails."""
    try:
        path.unlink()
    except FileNotFoundError:
        return
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """What was made in it, or taken away, is so after a power cut."""
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)
