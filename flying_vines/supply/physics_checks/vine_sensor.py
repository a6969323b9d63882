"""Are the readings of the vine's sensor possible?"""

from __future__ import annotations

from collections import deque

from flying_vines.supply.features import Features
from flying_vines.supply.physics_checks.expected import Expected

RESTED_S = 2.0
"""After the vine had all the time that it needs to come down."""
REFILLED_S = 0.7
"""Until ambient air is where the Venturi has sucked."""
BLOCK_S = 0.5
"""Readings are averaged over this time."""
SEALED_S = 0.15
FELL_KPA = 5.0
TOLERATED_KPA = 0.3
"""Above its setpoint the regulator leaves a vine alone."""
AT_ONCE_S = 0.035
"""A few readings: a fall in this time is no leak."""
NEIGHBOURS_S = 0.05
"""Further apart two readings differ because a vine comes down, or settles."""
UNSTEADY_S = 1.0
VINE_UNSTEADY_KPA = 1.2
BOTTLE_UNSTEADY_KPA = 9.0
"""The mean difference of readings that follow each other; a sound sensor's is a quarter of it."""


class Zero:
    """Checks the sensor's zero: the reading of a vine that has been vented for long.

    A sensor that reads too little is dangerous, because the vine gets more pressure than requested. It shows
    soon, because nothing sucks on a vented vine.
    """

    def __init__(self, rig: Expected) -> None:
        self._rig = rig
        self._after_s = RESTED_S + 3.0 * rig.slowest_vent_s
        self._sum_kPa_s = self._block_s = 0.0
        self._said: str | None = None

    def look(self, now: Features) -> str | None:
        """What is wrong, while it is."""
        if now.resting_s < REFILLED_S:
            self._sum_kPa_s = self._block_s = 0.0
            self._said = None
            return None
        self._sum_kPa_s += now.cv_median_kPa * now.device_dt_s
        self._block_s += now.device_dt_s
        if self._block_s >= BLOCK_S:
            zero_kPa = self._sum_kPa_s / self._block_s
            self._sum_kPa_s = self._block_s = 0.0
            wrong = zero_kPa < -self._rig.zero_kPa or (
                zero_kPa > self._rig.zero_kPa and now.resting_s > self._after_s
            )
            self._said = f"vine sensor reads {zero_kPa:.1f} kPa at rest" if wrong else None
        return self._said


class SuddenFall:
    """Finds a vine behind shut valves that loses its pressure from one reading to the next.

    It burst, its hose came off, or its sensor jumps, which would fill the vine beyond its limit.

    Above its setpoint, or on the way down, the regulator may have let air out too briefly for telemetry to
    show, and a small vine falls far meanwhile.
    """

    def __init__(self) -> None:
        self._lately: deque[tuple[float, float]] = deque()
        self._t = 0.0
        self._setpoint_kPa = 0.0
        self._fell_kPa: float | None = None

    def look(self, now: Features) -> str | None:
        """What is wrong; held until the vine is vented."""
        self._t += now.device_dt_s
        if now.resting_s > 0.0:
            self._fell_kPa = None
        setpoint_kPa = now.telemetry.setpoint_kPa
        may_vent = setpoint_kPa < self._setpoint_kPa or now.cv_median_kPa > setpoint_kPa + TOLERATED_KPA
        self._setpoint_kPa = setpoint_kPa
        if now.sealed_s < SEALED_S or may_vent:
            self._lately.clear()
        else:
            self._lately.append((self._t, now.cv_median_kPa))
            while self._lately[0][0] < self._t - AT_ONCE_S:
                self._lately.popleft()
            fell_kPa = self._lately[0][1] - now.cv_median_kPa
            if fell_kPa > FELL_KPA:
                self._fell_kPa = fell_kPa
        if self._fell_kPa is None:
            return None
        return f"vine fell {self._fell_kPa:.0f} kPa at once: burst or hose"


class Unsteady:
    """Finds readings that differ by more than noise while nothing moves: a loose contact."""

    def __init__(self) -> None:
        self._before: tuple[float, float] | None = None
        self._vine_kPa = self._bottle_kPa = 0.0
        self._seen_s = 0.0

    def look(self, now: Features) -> str | None:
        """What is wrong, while it is."""
        if max(now.resting_s, now.sealed_s) < SEALED_S or now.device_dt_s > NEIGHBOURS_S:
            self._before = None
            return self._sentence()
        if self._before is not None:
            vine_kPa, bottle_kPa = self._before
            share = min(1.0, now.device_dt_s / UNSTEADY_S)
            self._vine_kPa += share * (abs(now.telemetry.cv_kPa - vine_kPa) - self._vine_kPa)
            self._bottle_kPa += share * (abs(now.telemetry.reservoir_kPa - bottle_kPa) - self._bottle_kPa)
        self._before = now.telemetry.cv_kPa, now.telemetry.reservoir_kPa
        return self._sentence()

    def _sentence(self) -> str | None:
        if self._vine_kPa > VINE_UNSTEADY_KPA:
            return "vine sensor unsteady"
        return "bottle sensor unsteady" if self._bottle_kPa > BOTTLE_UNSTEADY_KPA else None
