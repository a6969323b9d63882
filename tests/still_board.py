"""A board that records its input and always sends the same valve outputs."""

from __future__ import annotations

from firmware_link.protocol import Fault, Mode
from flying_vines.physics.baseline import Inputs


class StillBoard:
    """Change `drive` to change the valve outputs from the next step on."""

    def __init__(self, drive: Inputs) -> None:
        self.drive = drive
        self.received = b""
        self.steps: list[tuple[int, float, float]] = []
        """Time and readings of each step: CV, reservoir."""
        self.resets: list[bool] = []
        """For each reset: true if it was the watchdog's."""
        self.mode, self.faults, self.number = Mode.VENT, Fault.NONE, 0

    def receive(self, data: bytes) -> None:
        self.received += data

    def take_output(self) -> bytes:
        return b"."

    def step(self, now_us: int, cv_kPa: float, reservoir_kPa: float) -> Inputs:
        self.steps.append((now_us, cv_kPa, reservoir_kPa))
        return self.drive

    def reset(self, *, watchdog: bool = False) -> None:
        self.resets.append(watchdog)
