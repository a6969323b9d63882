"""Where the flying-vines that runs is installed, and whether the service's user may run it from there.

pip, pipx and uv all make an environment with the command beside its Python, and a unit must name its place.
"""

from __future__ import annotations

import os
import stat
import sys
import sysconfig
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import flying_vines

GONE_AFTER_A_START = tuple(map(Path, ("/tmp", "/var/tmp", "/run", "/dev/shm")))


class InstallError(Exception):
    """It cannot be installed like this; the text is one line that says why, and what to do."""


@dataclass(frozen=True, slots=True)
class Program:
    """How it is called, and all that must be readable for it to run."""

    command: tuple[str, ...]
    places: tuple[Path, ...]

    @classmethod
    def here(cls) -> Program:
        """The one that runs. Where it has no command of its own, as part of its Python."""
        schemes = (sysconfig.get_default_scheme(), sysconfig.get_preferred_scheme("user"))
        scripts = (Path(sysconfig.get_path("scripts", scheme)) / "flying-vines" for scheme in schemes)
        script = next((path for path in scripts if os.access(path, os.X_OK)), None)
        python = Path(sys.executable)
        command = (str(script),) if script else (str(python), "-m", "flying_vines")
        package = Path(flying_vines.__file__)
        return cls(command, (*((script,) if script else ()), python, package))


@dataclass(frozen=True, slots=True)
class Reader:
    """Who is to read files: by number; a user who is yet to be made is nobody in particular."""

    name: str
    uid: int = -1
    groups: frozenset[int] = frozenset()

    def may(self, path: Path, bits: int) -> bool:
        """Whether all of `bits` (4 read, 1 pass through) are granted."""
        if self.uid == 0:
            return True
        status = path.stat()
        mode = stat.S_IMODE(status.st_mode)
        if status.st_uid == self.uid:
            mode >>= 6
        elif status.st_gid in self.groups:
            mode >>= 3
        return mode & bits == bits


def check_reachable(places: Iterable[Path], reader: Reader) -> None:
    """InstallError where a service that runs as `reader` could not read one of these, or not for long."""
    for place in places:
        # A link must be passed to, and so must what it leads to.
        for path in dict.fromkeys((place.absolute(), place.resolve())):
            if any(path.is_relative_to(folder) for folder in GONE_AFTER_A_START):
                raise InstallError(f"{path} is gone when the machine starts again: {_ELSEWHERE}")
            if ".cache" in path.parts:
                raise InstallError(f"{path} is in a cache, which may be emptied at any time: {_ELSEWHERE}")
            closed = _closed(path, reader)
            if closed:
                raise InstallError(
                    f"{closed} is closed to {reader.name}, the user of the service: {_ELSEWHERE}, or let"
                    " it run as somebody else with --user NAME"
                )


_ELSEWHERE = "put it where everybody may read it, such as /opt/flying-vines"


def _closed(path: Path, reader: Reader) -> Path | None:
    """The first on the way to `path` that does not let the reader in."""
    try:
        for folder in reversed(path.parents):
            if not reader.may(folder, 1):
                return folder
        return None if reader.may(path, 4) else path
    except OSError as error:
        raise InstallError(f"{error.filename}: {error.strerror}") from None
