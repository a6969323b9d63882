"""Checks whether the service already runs: a running service holds the ports."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from flying_vines.doctor.finding import DoctorFinding, FindingText


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


NONE = FindingText("service", "good", "no other service runs here")
ELSEWHERE = FindingText(
    "service",
    "warning",
    "{who} already runs, on other ports of this computer",
    "stop it ({stop}). If it serves another vehicle, give both services different component ids",
)
RUNS = FindingText(
    "service",
    "bad",
    "{who} already runs and uses the links, so they cannot be checked",
    "use flying-vines watch; or stop the service ({stop}) and repeat this check",
)


def named(processes: Sequence[Process]) -> str:
    return ", ".join(map(str, processes))


def stop(processes: Sequence[Process]) -> str:
    return "; ".join(process.stop for process in processes)


def check(running: Sequence[Process], holding: Sequence[Process]) -> DoctorFinding:
    """`holding`: the running services that use our links, or may use them."""
    if holding:
        return RUNS(who=named(holding), stop=stop(holding))
    return ELSEWHERE(who=named(running), stop=stop(running)) if running else NONE()
