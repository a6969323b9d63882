"""Is the service running already? Then the ports are its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from flying_vines.doctor.finding import Finding, Line


class Process(NamedTuple):
    """Another program on this computer."""

    pid: int
    name: str

    def __str__(self) -> str:
        return f"{self.name} (process {self.pid})"


NONE = Line("service", "good", "no other one runs here")
ELSEWHERE = Line(
    "service",
    "warning",
    "{who} runs already, on other links",
    "see that it is meant to: two services need two component ids",
)
RUNS = Line(
    "service",
    "bad",
    "{who} runs already, and holds the links: they cannot be looked at meanwhile",
    "read its log (journalctl -u flying-vines), or stop it (sudo systemctl stop flying-vines) and look again",
)


def named(processes: Sequence[Process]) -> str:
    return ", ".join(map(str, processes))


def check(running: Sequence[Process], holding: Sequence[Process]) -> Finding:
    """`holding` are those of the running ones that have our links, as far as anybody can tell."""
    if holding:
        return RUNS(who=named(holding))
    return ELSEWHERE(who=named(running)) if running else NONE()
