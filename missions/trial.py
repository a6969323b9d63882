"""What came of a mission that was flown in simulation."""

from __future__ import annotations

from dataclasses import dataclass

from flying_vines.core.events import Decision
from flying_vines.vehicle.mission.item import MissionItem


@dataclass(frozen=True, slots=True)
class Trial:
    """What came of it. Gauge kPa."""

    ran: tuple[MissionItem, ...]
    """The vine items that the autopilot ran, in order."""
    decisions: tuple[Decision, ...]
    """What the service decided about them."""
    begins_kPa: float
    ends_kPa: float
    length_s: float
    landed: bool
    flown_s: float
    """Simulated, with the time on the ground."""
    took_s: float
    """Of this machine's time."""

    @property
    def speed(self) -> float:
        """How many times real time."""
        return self.flown_s / max(1e-9, self.took_s)
