"""Is the service running already? Then the ports are its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from flying_vines.doctor.finding import DoctorFinding, FindingText


class Process(NamedTuple):
    """Another program on this computer."""

    pid: int
    name: str
    unit: str = ""
    """Of systemd, where the process is our service there."""

    def __str__(self) -> str:
        return f"{self.name} (process {self.pid}{', ' if self.unit else ''}{self.unit})"

    @property
    def stop(self) -> str:
        """How to end it: either way it vents first."""
        return f"sudo systemctl stop {self.unit}" if self.unit else f"kill {self.pid}"


NONE = FindingText("service", "good", "no other one runs here")
ELSEWHERE = FindingText(
    "service",
    "warning",
    "{who} runs already, on other ports of this computer",
    "stop it ({stop}), unless it serves another vehicle: two services need two component ids",
)
RUNS = FindingText(
    "service",
    "bad",
    "{who} runs already, and holds the links: they cannot be looked at meanwhile",
    "look at it with flying-vines watch, or stop it ({stop}) and look again",
)


def named(processes: Sequence[Process]) -> str:
    return ", ".join(map(str, processes))


def stop(processes: Sequence[Process]) -> str:
    return "; ".join(process.stop for process in processes)


def check(running: Sequence[Process], holding: Sequence[Process]) -> DoctorFinding:
    """`holding` are those of the running ones that have our links, as far as anybody can tell."""
    if holding:
        return RUNS(who=named(holding), stop=stop(holding))
    return ELSEWHERE(who=named(running), stop=stop(running)) if running else NONE()
