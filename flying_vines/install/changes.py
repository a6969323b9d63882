"""The file changes of an installation or removal below a root folder: found and shown, then made."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from flying_vines.config import on_disk
from flying_vines.install import files
from flying_vines.install.files import File


class How(Enum):
    NEW = "new"
    CHANGED = "changed"
    REMOVED = "removed"
    UNCHANGED = "unchanged"


@dataclass(frozen=True, slots=True)
class FileChange:
    """The change of one file."""

    path: Path
    how: How
    before: str = ""
    after: str = ""
    why: str = ""
    """Why the file is not changed."""

    def lines(self) -> Iterator[str]:
        """The lines to show before the change: the new text, or the difference."""
        if self.how is How.NEW:
            yield from self.after.splitlines()
        elif self.how is How.CHANGED:
            now, then = self.before.splitlines(), self.after.splitlines()
            yield from difflib.unified_diff(now, then, "now", "then", n=2, lineterm="")

    def make(self) -> None:
        """Raises `OSError` if it fails."""
        if self.how is How.REMOVED:
            on_disk.take_away(self.path)
        elif self.how is not How.UNCHANGED:
            on_disk.put(self.path, self.after)


def below(root: Path, path: Path) -> Path:
    """An absolute path, moved below `root`."""
    return root / path.relative_to("/")


def installing(wanted: Iterable[File], root: Path) -> list[FileChange]:
    """The change of each file. Raises `OSError` if an old file cannot be read."""
    return [_installed(file, below(root, file.path)) for file in wanted]


def removing(root: Path) -> list[FileChange]:
    """The removal of each existing file. A changed configuration and files of others stay.

    Raises `OSError`.
    """
    found = []
    for path in (below(root, path) for path in (files.UNIT, files.RULE, files.USERS)):
        if path.exists():
            ours = _read(path).startswith(files.HEAD)
            found.append(_removed(path, "" if ours else "install-service did not write it"))
    built_in = files.built_in_configuration()
    path = below(root, built_in.path)
    if path.exists():
        found.append(
            _removed(path, "" if _read(path) == built_in.text else "it differs from what this version writes")
        )
    return found


def holds_anything(folder: Path) -> bool:
    return folder.is_dir() and any(folder.iterdir())


def remove_empty(folder: Path) -> None:
    if folder.is_dir() and not holds_anything(folder):
        folder.rmdir()


def _installed(file: File, path: Path) -> FileChange:
    if not path.exists():
        return FileChange(path, How.NEW, after=file.text)
    if file.keep_existing:
        return FileChange(path, How.UNCHANGED, why="an existing configuration stays")
    before = _read(path)
    if before == file.text:
        return FileChange(path, How.UNCHANGED, why="it is already installed")
    return FileChange(path, How.CHANGED, before, file.text)


def _removed(path: Path, why_not: str) -> FileChange:
    return FileChange(path, How.UNCHANGED, why=why_not) if why_not else FileChange(path, How.REMOVED)


def _read(path: Path) -> str:
    return path.read_text(encoding="utf-8", errors="replace")
