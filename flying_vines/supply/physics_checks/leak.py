"""Checks that a held vine uses no air.

The openings of the inflation valve show little, because most of a short opening is within its dead zone. The
reservoir shows a leak: its pressure falls faster while the vine is held than while the vine is vented.
"""

from __future__ import annotations

from flying_vines.physics.gas import ALPHA_KPA
from flying_vines.supply.physics_checks.expected import Expected
from flying_vines.supply.telemetry_features import Features

# Time in which the gas in the filled vine cools, and the reservoir's gas warms. A larger vine takes longer.
SETTLED_S = 2.0
SETTLED_S_PER_L = 2.0
WATCHED_S = 4.0
MAX_SL_PER_S = 0.015
"""Three times the largest leak of a vine that is still usable."""


class _Slope:
    """The fall of the reservoir's pressure during a state: a line fitted over each `WATCHED_S`."""

    def __init__(self, settled_s: float) -> None:
        self._settled_s = settled_s
        self.falls_kPa_per_s: float | None = None
        self._begin()

    def _begin(self) -> None:
        self._seen_s = 0.0
        self._n = 0
        self._t = self._kPa = self._tt = self._t_kPa = 0.0

    def take(self, lasting_s: float, dt_s: float, kPa: float) -> bool:
        """Take in a reading. Returns True if a new slope is known."""
        if lasting_s < self._settled_s:
            self._begin()
            return False
        t = self._seen_s
        self._n += 1
        self._t += t
        self._kPa += kPa
        self._tt += t * t
        self._t_kPa += t * kPa
        self._seen_s += dt_s
        if self._seen_s < WATCHED_S:
            return False
        n = self._n
        self.falls_kPa_per_s = -(n * self._t_kPa - self._t * self._kPa) / (n * self._tt - self._t * self._t)
        self._begin()
        return True


class VineLeak:
    """Finds air that the reservoir loses to a held vine, in addition to its own leak."""

    def __init__(self, rig: Expected) -> None:
        self._rig = rig
        settled_s = SETTLED_S + SETTLED_S_PER_L * rig.vine_max_L
        self._rest = _Slope(settled_s)
        self._hold = _Slope(settled_s)
        self._finding: str | None = None

    def look(self, now: Features) -> str | None:
        """The finding. It stays until a hold shows no leak."""
        self._rest.take(now.resting_s, now.device_dt_s, now.telemetry.reservoir_kPa)
        complete = self._hold.take(now.holding_s, now.device_dt_s, now.telemetry.reservoir_kPa)
        held, rested = self._hold.falls_kPa_per_s, self._rest.falls_kPa_per_s
        if complete and held is not None and rested is not None:
            leak_SL_per_s = (held - rested) * self._rig.reservoir_L / ALPHA_KPA
            leaks = leak_SL_per_s > MAX_SL_PER_S
            self._finding = f"vine leaks {60.0 * leak_SL_per_s:.1f} SL/min while held" if leaks else None
        return self._finding
