"""Checks that the vine loses its pressure while its outlet is commanded open.

The slowest allowed rig (largest and softest vine, narrowest outlet) loses a quarter of its gauge pressure in
a time T. The vine must lose each quarter within 2 T, until it is vented. If it does not, the outlet stays
shut or the inflation valve stays open. An open valve also lowers the reservoir's pressure, but this does not
show while the Venturi takes air, too.
"""

from __future__ import annotations

from flying_vines.supply.physics_checks.expected import OUTLET_LAG_S, Expected
from flying_vines.supply.telemetry_features import VALVE_LAG_S, Features

DOWN_KPA = 3.0
"""The vine counts as vented up to this far above the largest zero of a good sensor."""
SHARE_LEFT = 0.75
LENIENCE = 2.0
LN_4_3 = 0.288


class VentingCheck:
    """Measures the time since the vine last lost a quarter of its pressure."""

    def __init__(self, rig: Expected) -> None:
        self._rig = rig
        self._due_s = OUTLET_LAG_S + LENIENCE * LN_4_3 * rig.slowest_vent_s
        self._above_kPa: float | None = None
        self._waited_s = 0.0
        self._venturi = False
        self._reservoir_kPa = 0.0

    def look(self, now: Features) -> str | None:
        above_kPa = now.cv_median_kPa - self._rig.zero_kPa
        if now.venting_s == 0.0 or above_kPa < DOWN_KPA:
            self._above_kPa = None
            return None
        if self._above_kPa is None or above_kPa < SHARE_LEFT * self._above_kPa:
            self._above_kPa = above_kPa
            self._waited_s = 0.0
            self._venturi = False
            self._reservoir_kPa = now.telemetry.reservoir_kPa
        self._waited_s += now.device_dt_s
        # The valves need some time to follow their commands.
        if now.venting_s > 2.0 * VALVE_LAG_S and self._rig.max_outflow_SL(now) > 0.0:
            self._venturi = True
        return self._sentence(now) if self._waited_s > self._due_s else None

    def _sentence(self, now: Features) -> str:
        if self._venturi:
            return "not venting: outlet, line, valve or sensor"
        open_valve_SL = self._waited_s * self._rig.open_evp_SL_per_s(now.telemetry.reservoir_kPa)
        fall_kPa = self._rig.reservoir_fall_kPa(open_valve_SL)
        if self._reservoir_kPa - now.telemetry.reservoir_kPa > fall_kPa / 3.0:
            return "not venting, valve stuck open: close the reservoir"
        return "not venting: outlet, line or sensor"
