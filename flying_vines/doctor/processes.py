"""Other processes on this computer and their open files, and whether the service already runs.

All from /proc, as far as this user may read it. A running service holds the ports.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from flying_vines.doctor.finding import DoctorFinding, Subject

PROC = Path("/proc")
_OUR_UNITS = re.compile(r"/(flying-vines[^/]*\.service)$", re.MULTILINE)
_TCP_LISTENS = "0A"
_PSEUDO = "/dev/pts/"
_PTY_MASTERS = ("/dev/ptmx", "/dev/pts/ptmx")
"""The device side of pseudo-terminals. A simulated device has this side open and may also keep the host side
open. It does not count as a user of the port."""


class Process(NamedTuple):
    """Another program on this computer."""

    pid: int
    name: str
    unit: str = ""
    """The systemd unit, if the process is our service; else empty."""

    def __str__(self) -> str:
        return f"{self.name} (process {self.pid}{', ' if self.unit else ''}{self.unit})"

    @property
    def stop(self) -> str:
        """The command that stops the process. Our service vents the vine before it ends."""
        return f"sudo systemctl stop {self.unit}" if self.unit else f"kill {self.pid}"


_SERVICE = Subject("service")
NO_SERVICE = _SERVICE.good("no other service runs here")
ELSEWHERE = _SERVICE.warning(
    "{who} already runs, on other ports of this computer",
    "stop it ({stop}). If it serves another vehicle, give both services different component ids",
)
RUNS = _SERVICE.bad(
    "{who} already runs and uses the links, so they cannot be checked",
    "use flying-vines watch; or stop the service ({stop}) and repeat this check",
)


def all_named(processes: Sequence[Process]) -> str:
    return ", ".join(map(str, processes))


def stop(processes: Sequence[Process]) -> str:
    return "; ".join(process.stop for process in processes)


def check_service(running: Sequence[Process], holding: Sequence[Process]) -> DoctorFinding:
    """`holding`: the running services that use our links, or may use them."""
    if holding:
        return RUNS(who=all_named(holding), stop=stop(holding))
    return ELSEWHERE(who=all_named(running), stop=stop(running)) if running else NO_SERVICE()


def _processes(proc: Path) -> Iterator[tuple[int, Path]]:
    """All processes except this one."""
    try:
        folders = sorted(proc.iterdir())
    except OSError:
        return
    for folder in folders:
        if folder.name.isdecimal() and int(folder.name) != os.getpid():
            yield int(folder.name), folder


def text_of(path: Path) -> str:
    """The text of a file of the system; empty if it is missing, or this user may not read it."""
    try:
        return path.read_text(errors="replace")
    except OSError:
        return ""


def _name(folder: Path) -> str:
    return text_of(folder / "comm").strip() or "?"


def services(proc: Path = PROC) -> list[Process]:
    """Each running `flying-vines run`."""
    return [
        Process(pid, "flying-vines run", _unit(folder))
        for pid, folder in _processes(proc)
        if _serves(text_of(folder / "cmdline").rstrip("\0").split("\0"))
    ]


def _unit(folder: Path) -> str:
    found = _OUR_UNITS.search(text_of(folder / "cgroup"))
    return found[1] if found else ""


def hides_files(process: Process, proc: Path = PROC) -> bool:
    """True if this user may not read the process's open files."""
    return not os.access(proc / str(process.pid) / "fd", os.R_OK)


def _serves(arguments: list[str]) -> bool:
    for i, argument in enumerate(arguments[:-1]):
        if Path(argument).name in ("flying-vines", "flying_vines") or argument.endswith(
            "flying_vines/__main__.py"
        ):
            return arguments[i + 1] == "run"
    return False


def runs(name: str, proc: Path = PROC) -> bool:
    """True if a program of this name runs."""
    return any(_name(folder) == name for _, folder in _processes(proc))


def holders(device: str, proc: Path = PROC) -> tuple[Process, ...]:
    """The processes that have a device open; for a pseudo-terminal only those on the host side."""
    real = os.path.realpath(device)
    device_side = _having(_PTY_MASTERS.__contains__, proc) if real.startswith(_PSEUDO) else ()
    return tuple(held for held in _having(real.__eq__, proc) if held not in device_side)


def port_holders(kind: str, port: int, proc: Path = PROC) -> tuple[Process, ...]:
    """The processes that listen on a port of this computer; `kind` is udp or tcp."""
    sockets = {f"socket:[{inode}]" for inode in _inodes(kind, port, proc)}
    return _having(sockets.__contains__, proc) if sockets else ()


def _inodes(kind: str, port: int, proc: Path) -> Iterator[str]:
    for table in (kind, f"{kind}6"):
        for row in text_of(proc / "net" / table).splitlines()[1:]:
            columns = row.split()
            if int(columns[1].rpartition(":")[2], 16) == port and (
                kind == "udp" or columns[3] == _TCP_LISTENS
            ):
                yield columns[9]


def _having(wanted: Callable[[str], bool], proc: Path) -> tuple[Process, ...]:
    return tuple(
        Process(pid, _name(folder)) for pid, folder in _processes(proc) if any(map(wanted, _open(folder)))
    )


def _open(folder: Path) -> Iterator[str]:
    """The open files of a process; nothing if this user may not read them."""
    try:
        descriptors = list((folder / "fd").iterdir())
    except OSError:
        return
    for descriptor in descriptors:
        try:
            yield str(descriptor.readlink())
        except OSError:
            continue
