"""The autopilot's state for telemetry, at one instant."""

from __future__ import annotations

from dataclasses import dataclass

from flying_vines.simulation.autopilot.flight import CopterMotion
from flying_vines.simulation.autopilot.modes import FlightMode
from flying_vines.simulation.autopilot.receiver import Receiver
from flying_vines.simulation.autopilot.runner import MissionStatus
from flying_vines.vehicle.mission.storage import AutopilotKind


@dataclass(frozen=True, slots=True)
class AutopilotSnapshot:
    kind: AutopilotKind
    mode: FlightMode
    armed: bool
    calibrating: bool
    rc_failsafe: bool
    rc_reported: bool
    """PX4's health report says that RC is good."""
    boot_s: float
    unix_s: float
    flight: CopterMotion
    receiver: Receiver
    mission: MissionStatus
    mission_id: int

    @property
    def boot_ms(self) -> int:
        return int(self.boot_s * 1000) & 0xFFFFFFFF
