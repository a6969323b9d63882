"""Who else runs on this computer, and what they hold open: read from /proc, as far as this user may."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path

from flying_vines.doctor.checks.service import Process

PROC = Path("/proc")
_OUR_UNITS = re.compile(r"/(flying-vines[^/]*\.service)$", re.MULTILINE)
_TCP_LISTENS = "0A"
_PSEUDO = "/dev/pts/"
_PLAYS = ("/dev/ptmx", "/dev/pts/ptmx")
"""The other end of pseudo-terminals: who has it open keeps the end of the hosts open as well."""


def _processes(proc: Path) -> Iterator[tuple[int, Path]]:
    """All but this one."""
    try:
        folders = sorted(proc.iterdir())
    except OSError:
        return
    for folder in folders:
        if folder.name.isdecimal() and int(folder.name) != os.getpid():
            yield int(folder.name), folder


def _arguments(folder: Path) -> list[str]:
    try:
        return (folder / "cmdline").read_bytes().decode(errors="replace").rstrip("\0").split("\0")
    except OSError:
        return []


def _name(folder: Path) -> str:
    try:
        return (folder / "comm").read_text(errors="replace").strip()
    except OSError:
        return "?"


def services(proc: Path = PROC) -> list[Process]:
    """Each `flying-vines run`, whoever started it."""
    return [
        Process(pid, "flying-vines run", _unit(folder))
        for pid, folder in _processes(proc)
        if _serves(_arguments(folder))
    ]


def _unit(folder: Path) -> str:
    try:
        found = _OUR_UNITS.search((folder / "cgroup").read_text(errors="replace"))
    except OSError:
        return ""
    return found[1] if found else ""


def secretive(process: Process, proc: Path = PROC) -> bool:
    """Whether this user may not know what it has open."""
    return not os.access(proc / str(process.pid) / "fd", os.R_OK)


def _serves(arguments: list[str]) -> bool:
    for i, argument in enumerate(arguments[:-1]):
        if Path(argument).name in ("flying-vines", "flying_vines") or argument.endswith(
            "flying_vines/__main__.py"
        ):
            return arguments[i + 1] == "run"
    return False


def named(name: str, proc: Path = PROC) -> bool:
    """Whether a program of this name runs."""
    return any(_name(folder) == name for _, folder in _processes(proc))


def holders(device: str, proc: Path = PROC) -> tuple[Process, ...]:
    """Who has a device open; of a pseudo-terminal not those who play the device."""
    real = os.path.realpath(device)
    playing = _having(_PLAYS.__contains__, proc) if real.startswith(_PSEUDO) else ()
    return tuple(held for held in _having(real.__eq__, proc) if held not in playing)


def port_holders(kind: str, port: int, proc: Path = PROC) -> tuple[Process, ...]:
    """Who listens on a port of this computer; `kind` is udp or tcp."""
    sockets = {f"socket:[{inode}]" for inode in _inodes(kind, port, proc)}
    return _having(sockets.__contains__, proc) if sockets else ()


def _inodes(kind: str, port: int, proc: Path) -> Iterator[str]:
    for table in (kind, f"{kind}6"):
        try:
            rows = (proc / "net" / table).read_text().splitlines()[1:]
        except OSError:
            continue
        for row in rows:
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
    """What a process has open; nothing where this user may not know."""
    try:
        descriptors = list((folder / "fd").iterdir())
    except OSError:
        return
    for descriptor in descriptors:
        try:
            yield str(descriptor.readlink())
        except OSError:
            continue
