"""Checks that the vine fills while the inflation valve is commanded open.

While the vine is below its setpoint, the reading must rise by `GAIN_KPA` before more air has gone in than any
vine takes for this rise. Air is counted, not time. So a low reservoir or a slightly open valve has more time.
"""

from __future__ import annotations

from flying_vines.supply.physics_checks.expected import OUTLET_LAG_S, Expected
from flying_vines.supply.telemetry_features import Features

GAIN_KPA = 2.0
BEHIND_KPA = 1.5
"""A vine that is nearer to its setpoint need not rise."""
LINE_KPA = 4.0
"""The sensor is at the valves. The flow in the tube to the vine raises its reading by up to this much."""
OUTLET_SHARE = 0.1
"""Share of the volume that a short opening of the outlet may have let out."""
MIN_FALL_KPA = 4.0
"""With a smaller expected fall, the reservoir's reading cannot show where the air went."""

# A sensor is stuck if all its readings are equal for one of these times.
STUCK_S = 0.2
"""While air goes in."""
STILL_S = 0.4
"""While the valve is commanded open. Perhaps nothing flows; then only noise changes the reading."""
STUCK_READINGS = 10
"""Two or three readings of a good sensor are often equal, and at 10 Hz three readings take 0.2 s."""


class Filling:
    """Counts the air that went in since the reading last rose by `GAIN_KPA`."""

    def __init__(self, rig: Expected) -> None:
        self._rig = rig
        self._flat_kPa = rig.zero_kPa + LINE_KPA
        self._full = False
        """The vine had pressure and has not been vented since. So the bending pouch is not flat."""
        self._begin(0.0, 0.0)

    def _begin(self, cv_kPa: float, reservoir_kPa: float) -> None:
        self._low_kPa = cv_kPa
        self._air_SL = 0.0
        self._reservoir_kPa = reservoir_kPa

    def look(self, now: Features) -> str | None:
        if now.cv_median_kPa > self._flat_kPa:
            self._full = True
        elif now.outlet_shut_s < OUTLET_LAG_S:
            self._full = False
        behind = now.regulating and now.telemetry.setpoint_kPa - now.cv_median_kPa > BEHIND_KPA
        if not behind or now.venting_s > 0.0 or now.cv_median_kPa > self._low_kPa + GAIN_KPA:
            self._begin(now.cv_median_kPa, now.telemetry.reservoir_kPa)
            return None
        self._low_kPa = min(self._low_kPa, now.cv_median_kPa)
        self._air_SL += self._rig.min_inflow_SL(now)
        enough_SL = self._rig.max_air_SL(GAIN_KPA)
        # A flat pouch takes its whole volume before its pressure rises. A full one may have lost some air
        # through an opening of the outlet that was too short for telemetry.
        enough_SL += self._rig.vine_max_L * (OUTLET_SHARE if self._full else 1.0)
        return self._sentence(now) if self._air_SL > enough_SL else None

    def _sentence(self, now: Features) -> str:
        fall_kPa = self._rig.reservoir_fall_kPa(self._air_SL)
        if fall_kPa < MIN_FALL_KPA:
            return "not filling: valve, hose or actuator"
        if self._reservoir_kPa - now.telemetry.reservoir_kPa < 0.3 * fall_kPa:
            return "not filling, reservoir loses no air: valve"
        return "not filling, air is lost: hose or actuator"


class StuckVineSensor:
    """Finds a reading that does not change at all while air goes in.

    The reading of a good sensor changes. If a pouch unfolds without pressure, the flow in the tube still
    changes the reading, and every converter has some noise. Near the setpoint the regulator opens the valve a
    little, and further while the reading does not change.
    """

    def __init__(self, rig: Expected) -> None:
        self._rig = rig
        self._reading_kPa = 0.0
        self._filling_s = self._open_s = 0.0
        self._same = 0

    def look(self, now: Features) -> str | None:
        if now.telemetry.cv_kPa != self._reading_kPa or not now.regulating or now.venting_s > 0.0:
            self._reading_kPa = now.telemetry.cv_kPa
            self._filling_s = self._open_s = 0.0
            self._same = 0
        elif now.telemetry.evp_opening > 0.0:
            self._same += 1
            self._open_s += now.device_dt_s
            self._filling_s += now.device_dt_s if self._rig.min_inflow_SL(now) > 0.0 else 0.0
        long = self._filling_s > STUCK_S or self._open_s > STILL_S
        stuck = long and self._same >= STUCK_READINGS
        return f"vine sensor stuck at {now.telemetry.cv_kPa:.1f} kPa" if stuck else None
