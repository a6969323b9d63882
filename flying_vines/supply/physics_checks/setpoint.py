"""Checks that the vine's pressure comes to its setpoint, whatever the valves are commanded.

`filling` and `venting` compare the pressure with the commands of the valves. If the board commands nothing,
or if its sensor is wrong, only the distance from the setpoint remains. Each check waits longer than the
slowest allowed rig needs.
"""

from __future__ import annotations

from flying_vines.supply.physics_checks.expected import OUTLET_LAG_S, Expected
from flying_vines.supply.physics_checks.venting import LENIENCE, LN_4_3, SHARE_LEFT
from flying_vines.supply.telemetry_features import Features

BELOW_KPA = 2.0
MIN_BELOW_S = 2.0
"""Near the setpoint the regulator opens the valve slowly."""
ABOVE_KPA = 2.0
PATIENCE_S = 0.3
"""The regulator vents a small excess after this time."""


class BelowSetpoint:
    """Finds a vine that stays below its setpoint although the open valve would have filled any vine."""

    def __init__(self, rig: Expected) -> None:
        self._rig = rig
        self._begin()

    def _begin(self) -> None:
        self._low_kPa: float | None = None
        self._below_s = self._possible_SL = 0.0

    def look(self, now: Features) -> str | None:
        setpoint_kPa, cv_kPa = now.telemetry.setpoint_kPa, now.cv_median_kPa
        too_low = setpoint_kPa > self._rig.zero_kPa and setpoint_kPa - cv_kPa > BELOW_KPA
        if not now.regulating or not too_low:
            self._begin()
            return None
        self._low_kPa = cv_kPa if self._low_kPa is None else min(self._low_kPa, cv_kPa)
        self._below_s += now.device_dt_s
        self._possible_SL += self._rig.open_inflow_SL(now)
        # A flat pouch takes its whole volume before its pressure rises.
        enough_SL = self._rig.max_air_SL(setpoint_kPa - self._low_kPa) + self._rig.vine_max_L
        if self._below_s < MIN_BELOW_S or self._possible_SL < enough_SL:
            return None
        return (
            f"vine at {max(0.0, cv_kPa):.0f} of {setpoint_kPa:.1f} kPa for {self._below_s:.0f} s: "
            "leak, hose, valve or empty reservoir"
        )


class AboveSetpoint:
    """Finds a vine that stays above its setpoint: it must lose a quarter of its pressure, as in `venting`."""

    def __init__(self, rig: Expected) -> None:
        self._rig = rig
        self._due_s = PATIENCE_S + OUTLET_LAG_S + LENIENCE * LN_4_3 * rig.slowest_vent_s
        self._above_kPa: float | None = None
        self._above_s = 0.0

    def look(self, now: Features) -> str | None:
        setpoint_kPa, cv_kPa = now.telemetry.setpoint_kPa, now.cv_median_kPa
        if not now.regulating or cv_kPa < max(setpoint_kPa, self._rig.zero_kPa) + ABOVE_KPA:
            self._above_kPa = None
            return None
        if self._above_kPa is None or cv_kPa < SHARE_LEFT * self._above_kPa:
            self._above_kPa, self._above_s = cv_kPa, 0.0
        self._above_s += now.device_dt_s
        if self._above_s < self._due_s:
            return None
        return f"vine at {cv_kPa:.1f} kPa stays above its setpoint {setpoint_kPa:.1f}"
