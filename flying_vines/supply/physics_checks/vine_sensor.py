"""Checks that the readings of the vine's sensor are physically possible."""

from __future__ import annotations

from collections import deque

from flying_vines.supply.physics_checks.expected import Expected
from flying_vines.supply.telemetry_features import Features

RESTED_S = 2.0
"""Additional time after the maximum time that a vine needs to vent."""
REFILLED_S = 0.7
"""Time in which ambient air fills the vacuum of the Venturi."""
BLOCK_S = 0.5
"""Averaging time of readings."""
SEALED_S = 0.15
FELL_KPA = 5.0
TOLERATED_KPA = 0.3
"""Up to this far above its setpoint the regulator does not vent the vine."""
AT_ONCE_S = 0.035
"""The time of a few readings. A fall in this time is not a leak."""
NEIGHBOURS_S = 0.05
"""Two readings further apart may also differ because the vine vents or settles."""
UNSTEADY_S = 1.0

# Limits of the mean difference between successive readings: four times that of a good sensor.
VINE_UNSTEADY_KPA = 1.2
RESERVOIR_UNSTEADY_KPA = 9.0


class Zero:
    """Checks the sensor's zero: the reading of a vine after a long vent.

    A sensor that reads too low is dangerous, because the vine gets more pressure than requested. Such a
    sensor is found earlier than one that reads too high: a vented vine is never below ambient pressure.
    """

    def __init__(self, rig: Expected) -> None:
        self._rig = rig
        self._after_s = RESTED_S + 3.0 * rig.slowest_vent_s
        self._sum_kPa_s = self._block_s = 0.0
        self._finding: str | None = None

    def look(self, now: Features) -> str | None:
        if now.resting_s < REFILLED_S:
            self._sum_kPa_s = self._block_s = 0.0
            self._finding = None
            return None
        self._sum_kPa_s += now.cv_median_kPa * now.device_dt_s
        self._block_s += now.device_dt_s
        if self._block_s >= BLOCK_S:
            zero_kPa = self._sum_kPa_s / self._block_s
            self._sum_kPa_s = self._block_s = 0.0
            wrong = zero_kPa < -self._rig.zero_kPa or (
                zero_kPa > self._rig.zero_kPa and now.resting_s > self._after_s
            )
            self._finding = f"vine sensor reads {zero_kPa:.1f} kPa at rest" if wrong else None
        return self._finding


class SuddenFall:
    """Finds a vine that suddenly loses its pressure although all valves are shut.

    It burst, its hose came off, or its sensor jumps. After such a jump the regulator overfills the vine.

    If the vine is above its setpoint, or the setpoint falls, the regulator may vent too briefly for telemetry
    to show it. A small vine loses much pressure in that time, so such falls do not count.
    """

    def __init__(self) -> None:
        self._recent: deque[tuple[float, float]] = deque()
        self._t = 0.0
        self._setpoint_kPa = 0.0
        self._fell_kPa: float | None = None

    def look(self, now: Features) -> str | None:
        """The finding, until the vine is vented."""
        self._t += now.device_dt_s
        if now.resting_s > 0.0:
            self._fell_kPa = None
        setpoint_kPa = now.telemetry.setpoint_kPa
        may_vent = setpoint_kPa < self._setpoint_kPa or now.cv_median_kPa > setpoint_kPa + TOLERATED_KPA
        self._setpoint_kPa = setpoint_kPa
        if now.sealed_s < SEALED_S or may_vent:
            self._recent.clear()
        else:
            self._recent.append((self._t, now.cv_median_kPa))
            while self._recent[0][0] < self._t - AT_ONCE_S:
                self._recent.popleft()
            fell_kPa = self._recent[0][1] - now.cv_median_kPa
            if fell_kPa > FELL_KPA:
                self._fell_kPa = fell_kPa
        if self._fell_kPa is None:
            return None
        return f"vine fell {self._fell_kPa:.0f} kPa at once: burst or hose"


class Unsteady:
    """Finds a loose contact: readings vary by more than noise while the vine is at rest."""

    def __init__(self) -> None:
        self._before: tuple[float, float] | None = None
        self._vine_kPa = self._reservoir_kPa = 0.0

    def look(self, now: Features) -> str | None:
        if max(now.resting_s, now.sealed_s) < SEALED_S or now.device_dt_s > NEIGHBOURS_S:
            self._before = None
            return self._sentence()
        if self._before is not None:
            vine_kPa, reservoir_kPa = self._before
            share = min(1.0, now.device_dt_s / UNSTEADY_S)
            self._vine_kPa += share * (abs(now.telemetry.cv_kPa - vine_kPa) - self._vine_kPa)
            self._reservoir_kPa += share * (
                abs(now.telemetry.reservoir_kPa - reservoir_kPa) - self._reservoir_kPa
            )
        self._before = now.telemetry.cv_kPa, now.telemetry.reservoir_kPa
        return self._sentence()

    def _sentence(self) -> str | None:
        if self._vine_kPa > VINE_UNSTEADY_KPA:
            return "vine sensor unsteady"
        return "reservoir sensor unsteady" if self._reservoir_kPa > RESERVOIR_UNSTEADY_KPA else None
