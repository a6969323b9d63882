"""The result of a simulated flight of a mission."""

from __future__ import annotations

from dataclasses import dataclass

from flying_vines.core.events import Decision
from flying_vines.vehicle.mission.item import MissionItem


@dataclass(frozen=True, slots=True)
class FlightResult:
    """The result of one flight; pressures are gauge."""

    ran: tuple[MissionItem, ...]
    """The vine items that the autopilot ran, in order."""
    decisions: tuple[Decision, ...]
    """The service's decisions about them."""
    begins_kPa: float
    ends_kPa: float
    length_s: float
    """Simulated time from the start of the mission to the landing, or until the flight was stopped."""
    landed: bool
    flown_s: float
    """`length_s` and the time on the ground before it."""
    took_s: float
    """Real time on this computer."""

    @property
    def speed(self) -> float:
        """Simulated time divided by real time."""
        return self.flown_s / max(1e-9, self.took_s)
