"""Where this flying-vines is installed, and whether the service's user can run it there."""

from __future__ import annotations

import os
import stat
import sys
import sysconfig
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import flying_vines

IN_IMAGE = tuple(
    Path(folder, "flying-vines") for folder in ("/opt/flying-vines/bin", "/usr/local/bin", "/usr/bin")
)
"""Where a system image may have the program, as the installation guide names the places."""
VOLATILE_FOLDERS = tuple(map(Path, ("/tmp", "/var/tmp", "/run", "/dev/shm")))


class InstallError(Exception):
    """The service cannot be installed. The text is one line: why, and what to do."""


@dataclass(frozen=True, slots=True)
class InstalledProgram:
    """The command, and the paths that must be readable to run it."""

    command: tuple[str, ...]
    places: tuple[Path, ...]

    @classmethod
    def below(cls, root: Path) -> InstalledProgram:
        """The program in the system image at `root`; where the guide installs it, if it is not there yet."""
        found = (path for path in IN_IMAGE if os.path.lexists(root / path.relative_to("/")))
        return cls((str(next(found, IN_IMAGE[0])),), ())

    @classmethod
    def here(cls) -> InstalledProgram:
        """The running program; `python -m flying_vines` if there is no `flying-vines` command."""
        schemes = (sysconfig.get_default_scheme(), sysconfig.get_preferred_scheme("user"))
        scripts = (Path(sysconfig.get_path("scripts", scheme)) / "flying-vines" for scheme in schemes)
        script = next((path for path in scripts if os.access(path, os.X_OK)), None)
        python = Path(sys.executable)
        command = (str(script),) if script else (str(python), "-m", "flying_vines")
        package = Path(flying_vines.__file__)
        return cls(command, (*((script,) if script else ()), python, package))


@dataclass(frozen=True, slots=True)
class FileReader:
    """The user that reads files. A user that does not exist yet has no uid and no groups."""

    name: str
    uid: int = -1
    groups: frozenset[int] = frozenset()

    def may(self, path: Path, bits: int) -> bool:
        """True if the user has all permission `bits`: 4 read, 1 enter a folder."""
        if self.uid == 0:
            return True
        status = path.stat()
        mode = stat.S_IMODE(status.st_mode)
        if status.st_uid == self.uid:
            mode >>= 6
        elif status.st_gid in self.groups:
            mode >>= 3
        return mode & bits == bits


def check_reachable(places: Iterable[Path], reader: FileReader) -> None:
    """Raises `InstallError` if `reader` cannot read one of these places, now or after a restart."""
    for place in places:
        # A link and its target must both be readable.
        for path in dict.fromkeys((place.absolute(), place.resolve())):
            if any(path.is_relative_to(folder) for folder in VOLATILE_FOLDERS):
                raise InstallError(
                    f"{path} is in a temporary folder, which can be emptied at any time: {_ELSEWHERE}"
                )
            if ".cache" in path.parts:
                raise InstallError(f"{path} is in a cache, which can be emptied at any time: {_ELSEWHERE}")
            closed = _closed(path, reader)
            if closed:
                raise InstallError(
                    f"{reader.name}, the user of the service, cannot read {closed}: {_ELSEWHERE}, or let"
                    " the service run as another user with --user NAME"
                )


_ELSEWHERE = "install it where every user can read it, for example in /opt/flying-vines"


def _closed(path: Path, reader: FileReader) -> Path | None:
    """The first part of `path` that the reader cannot read."""
    try:
        for folder in reversed(path.parents):
            if not reader.may(folder, 1):
                return folder
        return None if reader.may(path, 4) else path
    except OSError as error:
        raise InstallError(f"{error.filename}: {error.strerror}") from None
