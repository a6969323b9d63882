"""The paper's pressure regulator: on-off when far from the setpoint, PID when near.

Far away (by more than 1 kPa) the valves go fully open. Near, the inflation valve follows a PID, and the
solenoid, which is open or closed, has a small dead band. Air leaves by itself where that is fast enough;
only otherwise does the Venturi help, for it costs air.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple


class Drive(NamedTuple):
    """What the valves are told: openings 0…1, solenoid open or not."""

    evp: float
    dvp: float
    solenoid: bool


SAFE = Drive(0.0, 0.0, True)
"""Nothing goes in, everything may leave, and no air is spent on it."""


@dataclass(frozen=True)
class RegulatorSettings:
    """Tuned for the vine's 0.1 L on a full 2 L bottle; good from there up to a litre."""

    on_off_error_kPa: float = 1.0
    proportional_per_kPa: float = 0.3
    integral_per_kPa_s: float = 1.0
    derivative_s_per_kPa: float = 0.0005
    smallest_error_kPa: float = 0.05
    """Below it the inflation valve stays shut: noise must not pump."""
    solenoid_opens_kPa: float = 0.5
    solenoid_closes_kPa: float = 0.1
    """Above the setpoint."""
    filter_s: float = 0.003
    slope_filter_s: float = 0.02
    active_error_kPa: float = 3.0
    """Nearer than this the Venturi is not started."""
    passive_first_s: float = 0.03
    """How long air may leave by itself before its speed is judged."""
    patience_s: float = 0.3
    """Within this the pressure should arrive at a setpoint that stands still."""
    venturi_least_supply_kPa: float = 100.0
    """Below it the Venturi spends air and makes no vacuum to speak of."""


class Regulator:
    """One regulation, from `start` on; the setpoint begins at the measured pressure, so nothing jumps."""

    def __init__(self, settings: RegulatorSettings, cv_kPa: float) -> None:
        self.setpoint_kPa = max(0.0, cv_kPa)
        """What is held now, on its way to the target."""
        self._settings = settings
        self._target_kPa = self.setpoint_kPa
        self._rate_kPa_per_s = 0.0
        self._cv_kPa = cv_kPa
        self._slope_kPa_per_s = 0.0
        self._integral = 0.0
        self._solenoid = False
        self._venturi = False
        self._too_high_s = 0.0

    def aim(self, target_kPa: float, rate_kPa_per_s: float) -> None:
        """Where to go from here, and how fast at most."""
        self._target_kPa = target_kPa
        self._rate_kPa_per_s = rate_kPa_per_s

    def step(self, dt_s: float, cv_kPa: float, reservoir_kPa: float) -> Drive:
        """The valves for the next `dt_s` (positive), from pressures just read."""
        settings = self._settings
        setpoint_slope = self._move_setpoint(dt_s)
        self._observe(dt_s, cv_kPa)
        error = self.setpoint_kPa - self._cv_kPa
        if error < -settings.on_off_error_kPa:
            self._integral = 0.0
            self._solenoid = True
            self._judge_speed(dt_s, error, setpoint_slope, reservoir_kPa)
            return Drive(0.0, 1.0 if self._venturi else 0.0, True)
        self._venturi = False
        self._too_high_s = 0.0
        if error > settings.on_off_error_kPa:
            self._solenoid = False
            return Drive(1.0, 0.0, False)
        if error > -settings.solenoid_closes_kPa:
            self._solenoid = False
        elif error < -settings.solenoid_opens_kPa:
            self._solenoid = True
        # On the way down what fell too far is waited for, not filled up again.
        if self._solenoid or setpoint_slope < 0.0:
            self._integral = 0.0
            return Drive(0.0, 0.0, self._solenoid)
        return Drive(self._inflation(dt_s, error), 0.0, False)

    def _move_setpoint(self, dt_s: float) -> float:
        most = self._rate_kPa_per_s * dt_s
        move = min(most, max(-most, self._target_kPa - self.setpoint_kPa))
        self.setpoint_kPa += move
        return move / dt_s

    def _observe(self, dt_s: float, cv_kPa: float) -> None:
        settings = self._settings
        change = (cv_kPa - self._cv_kPa) * dt_s / (settings.filter_s + dt_s)
        self._cv_kPa += change
        self._slope_kPa_per_s += (
            (change / dt_s - self._slope_kPa_per_s) * dt_s / (settings.slope_filter_s + dt_s)
        )

    def _inflation(self, dt_s: float, error: float) -> float:
        settings = self._settings
        if error < settings.smallest_error_kPa:
            self._integral = 0.0
            return 0.0
        opening = (
            settings.proportional_per_kPa * error
            + self._integral
            - settings.derivative_s_per_kPa * self._slope_kPa_per_s
        )
        # Integrated only while the valve can still follow.
        if opening < 1.0:
            self._integral = min(1.0, self._integral + settings.integral_per_kPa_s * error * dt_s)
        return min(1.0, max(0.0, opening))

    def _judge_speed(self, dt_s: float, error: float, setpoint_slope: float, reservoir_kPa: float) -> None:
        settings = self._settings
        if reservoir_kPa < settings.venturi_least_supply_kPa:
            self._venturi = False
            return
        if error >= -settings.active_error_kPa:
            self._too_high_s = 0.0
            return
        self._too_high_s += dt_s
        if self._too_high_s >= settings.passive_first_s:
            wanted = max(-setpoint_slope, -error / settings.patience_s)
            self._venturi = self._venturi or -self._slope_kPa_per_s < wanted
