"""The interface of a mission runner, and the interface of the autopilot that uses the runner."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from flying_vines.simulation.autopilot.flight import CopterMotion
from flying_vines.simulation.autopilot.scheduler import Scheduler
from flying_vines.vehicle.mission.item import MissionItem

NO_MISSION, NOT_STARTED, ACTIVE, PAUSED, COMPLETE = 1, 2, 3, 4, 5


@dataclass(frozen=True, slots=True)
class MissionStatus:
    """The content of MISSION_CURRENT."""

    seq: int
    total: int
    state: int
    mode: int


class Host(Protocol):
    """The autopilot as its mission runner sees it."""

    scheduler: Scheduler
    flight: CopterMotion

    @property
    def items(self) -> list[MissionItem]: ...
    @property
    def armed(self) -> bool: ...
    def text(self, text: str, severity: int = 6) -> None:
        """Send a status text to all links that get texts."""

    def reached(self, seq: int) -> None:
        """Set MISSION_ITEM_REACHED. Only the last one of a loop is sent, at the end of the loop."""

    def executed(self, item: MissionItem) -> None:
        """A DO item was executed."""

    def flush(self) -> None:
        """End a loop now, outside the autopilot's ticks: send its texts and MISSION_ITEM_REACHED."""


class Runner(Protocol):
    """Runs a mission. All methods may be called at any time."""

    def enter(self) -> None:
        """The mission mode was selected."""

    def leave(self) -> None:
        """Another mode was selected."""

    def update(self) -> None:
        """Called once per loop in the mission mode."""

    def disarmed(self) -> None:
        """The vehicle was disarmed in the mission mode."""

    def replaced(self) -> None:
        """Another mission was loaded."""

    def set_current(self, seq: int) -> None: ...
    def status(self, in_mission_mode: bool) -> MissionStatus: ...
