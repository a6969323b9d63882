"""Does the vine fill while the inflation valve is commanded open?

While the vine is below its setpoint, the reading must gain `GAIN_KPA` before more air has gone in than any
vine takes for that. Air is counted, not time: a weak bottle or a valve that is just open has longer.
"""

from __future__ import annotations

from flying_vines.supply.features import Features
from flying_vines.supply.physics_checks.expected import Expected

GAIN_KPA = 2.0
BEHIND_KPA = 1.5
"""Nearer to its setpoint the vine need not rise."""
LINE_KPA = 4.0
"""What the flow in the tube adds to the reading at its near end."""
LET_OUT = 0.1
TELLING_KPA = 4.0
"""How far the bottle should have fallen, for its reading to tell where the air went."""
OUTLET_LAG_S = 0.15
"""An outlet may let air out for so long after the command to shut."""
STUCK_S = 0.2
"""A sensor whose every reading is the same for so long, while air goes in …"""
STILL_S = 0.4
"""… or while the valve is commanded open and perhaps nothing flows: then only noise can show it."""
STUCK_READINGS = 10
"""Two or three readings of a sound sensor are often the same, and at 10 Hz that is 0.2 s."""


class Filling:
    """Counts the air that went in since the reading last rose."""

    def __init__(self, rig: Expected) -> None:
        self._rig = rig
        self._flat_kPa = rig.zero_kPa + LINE_KPA
        self._full = False
        """The vine had pressure and was not vented since: it is no flat pouch."""
        self._begin(0.0, 0.0)

    def _begin(self, cv_kPa: float, bottle_kPa: float) -> None:
        self._low_kPa = cv_kPa
        self._air_SL = 0.0
        self._bottle_kPa = bottle_kPa

    def look(self, now: Features) -> str | None:
        """What is wrong, while it is."""
        if now.cv_median_kPa > self._flat_kPa:
            self._full = True
        elif now.outlet_shut_s < OUTLET_LAG_S:
            self._full = False
        behind = now.regulating and now.telemetry.setpoint_kPa - now.cv_median_kPa > BEHIND_KPA
        if not behind or now.venting_s > 0.0 or now.cv_median_kPa > self._low_kPa + GAIN_KPA:
            self._begin(now.cv_median_kPa, now.telemetry.reservoir_kPa)
            return None
        self._low_kPa = min(self._low_kPa, now.cv_median_kPa)
        self._air_SL += self._rig.least_inflow_SL(now)
        enough_SL = self._rig.most_air_SL(GAIN_KPA)
        # A pouch takes its whole volume before its pressure rises at all; a full one may have been let out a
        # little, too briefly for telemetry to show.
        enough_SL += self._rig.vine_most_L * (LET_OUT if self._full else 1.0)
        return self._sentence(now) if self._air_SL > enough_SL else None

    def _sentence(self, now: Features) -> str:
        fall_kPa = self._rig.bottle_fall_kPa(self._air_SL)
        if fall_kPa < TELLING_KPA:
            return "not filling: valve, hose or actuator"
        if self._bottle_kPa - now.telemetry.reservoir_kPa < 0.3 * fall_kPa:
            return "not filling, bottle keeps its air: valve"
        return "not filling, air is lost: hose or actuator"


class StuckVineSensor:
    """Finds a reading that does not change in its last digit while air goes in.

    Even a pouch that unfolds at no pressure changes the reading, by the flow in the tube, and every
    converter has some noise. Near its setpoint the regulator opens the valve a little, and further while
    nothing changes.
    """

    def __init__(self, rig: Expected) -> None:
        self._rig = rig
        self._reading_kPa = 0.0
        self._filling_s = self._told_s = 0.0
        self._same = 0

    def look(self, now: Features) -> str | None:
        """What is wrong, while it is."""
        if now.telemetry.cv_kPa != self._reading_kPa or not now.regulating or now.venting_s > 0.0:
            self._reading_kPa = now.telemetry.cv_kPa
            self._filling_s = self._told_s = 0.0
            self._same = 0
        elif now.telemetry.evp_opening > 0.0:
            self._same += 1
            self._told_s += now.device_dt_s
            self._filling_s += now.device_dt_s if self._rig.least_inflow_SL(now) > 0.0 else 0.0
        long = self._filling_s > STUCK_S or self._told_s > STILL_S
        stuck = long and self._same >= STUCK_READINGS
        return f"vine sensor stuck at {now.telemetry.cv_kPa:.1f} kPa" if stuck else None
