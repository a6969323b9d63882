"""Records the valve outputs between firmware and plant, to the millisecond of the board."""

from __future__ import annotations

from wrapped_board import WrappedBoard

from firmware_link.protocol import Codec, Setpoint
from flying_vines.physics.baseline import Inputs
from flying_vines.simulation.phlosar.phlosar import SimulatedPhlosar

STEP_S = 0.001


class BlackBox(WrappedBoard):
    """Replaces the firmware of a simulated phloSAR, and records its inputs and outputs.

    All times are the board's, in seconds. Safe means: inflation valve commanded shut, solenoid commanded
    open.
    """

    def __init__(self, phlosar: SimulatedPhlosar) -> None:
        super().__init__(phlosar.firmware)
        self._phlosar = phlosar
        self._decoder = Codec()
        self.unsafe_s: float | None = None
        """Time of the last step with unsafe valves; None before the first."""
        self.setpoint_s: float | None = None
        """Arrival of the last setpoint."""
        self.highest_kPa = 0.0
        self._over_ms = 0
        self._limit_kPa = float("inf")
        self.longest_over_ms = 0
        """Longest time in a row with the control volume above the limit given to `watch`."""
        phlosar.firmware = self

    def watch(self, limit_kPa: float) -> None:
        """Record the highest pressure, and pressures above a limit, from now on."""
        self._limit_kPa = limit_kPa
        self.highest_kPa = self._phlosar.cv_kPa
        self.longest_over_ms = self._over_ms = 0

    def look(self) -> None:
        """Read the phloSAR itself every millisecond, because its firmware may not be running."""
        if self._phlosar.drive.evp > 0.0 or not self._phlosar.drive.solenoid:
            self.unsafe_s = self._phlosar.now_s
        true_kPa = self._phlosar.cv_kPa
        self.highest_kPa = max(self.highest_kPa, true_kPa)
        self._over_ms = self._over_ms + 1 if true_kPa > self._limit_kPa else 0
        self.longest_over_ms = max(self.longest_over_ms, self._over_ms)

    def step(self, now_us: int, cv_kPa: float, reservoir_kPa: float) -> Inputs:
        drive = super().step(now_us, cv_kPa, reservoir_kPa)
        if drive.evp > 0.0 or not drive.solenoid:
            self.unsafe_s = now_us / 1e6
        return drive

    def receive(self, data: bytes) -> None:
        if any(isinstance(message, Setpoint) for message in self._decoder.decode(data)):
            self.setpoint_s = self._phlosar.now_s
        super().receive(data)
