"""Does it cost air to hold the vine?

How often the inflation valve opens says little, since most of a short opening is within its dead zone. The
bottle shows it: its pressure falls faster while the vine is held than while the vine was vented.
"""

from __future__ import annotations

from flying_vines.physics.constants import ALPHA_KPA
from flying_vines.supply.features import Features
from flying_vines.supply.physics_checks.expected import Expected

SETTLED_S = 2.0
SETTLED_S_PER_L = 2.0
"""After the vine was filled, its gas has cooled, and the bottle's has warmed: a larger vine takes longer."""
WATCHED_S = 4.0
MOST_SL_PER_S = 0.015
"""Three times what the largest leak of a vine takes that is still of use."""


class _Slope:
    """How fast the bottle's pressure falls during a state: a line through each `WATCHED_S`."""

    def __init__(self, settled_s: float) -> None:
        self._settled_s = settled_s
        self.falls_kPa_per_s: float | None = None
        self._begin()

    def _begin(self) -> None:
        self._seen_s = 0.0
        self._n = 0
        self._t = self._kPa = self._tt = self._t_kPa = 0.0

    def take(self, lasting_s: float, dt_s: float, kPa: float) -> bool:
        """Take in a reading. Returns whether a new slope is known."""
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
    """Finds what the bottle loses to a held vine, in addition to what it loses anyway."""

    def __init__(self, rig: Expected) -> None:
        self._rig = rig
        settled_s = SETTLED_S + SETTLED_S_PER_L * rig.vine_most_L
        self._rest = _Slope(settled_s)
        self._hold = _Slope(settled_s)
        self._said: str | None = None

    def look(self, now: Features) -> str | None:
        """What is wrong, until a hold without it."""
        self._rest.take(now.resting_s, now.device_dt_s, now.telemetry.reservoir_kPa)
        complete = self._hold.take(now.holding_s, now.device_dt_s, now.telemetry.reservoir_kPa)
        held, rested = self._hold.falls_kPa_per_s, self._rest.falls_kPa_per_s
        if complete and held is not None and rested is not None:
            leak_SL_per_s = (held - rested) * self._rig.bottle_L / ALPHA_KPA
            leaks = leak_SL_per_s > MOST_SL_PER_S
            self._said = f"vine leaks {60.0 * leak_SL_per_s:.1f} SL/min while held" if leaks else None
        return self._said
