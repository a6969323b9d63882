"""One telemetry message as the checks see it: what was told for how long, and what that must have moved."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from firmware_link.protocol import Mode, Telemetry
from flying_vines.supply.physics_checks.expected import Expected

VALVE_LAG_S = 0.06
"""Delay and lag of a valve, and of the sensor behind its tube."""
JUST_S = 0.001
"""What has just been seen has lasted so long, for sure."""


class Moment(NamedTuple):
    """Gauge kPa. `..._s` is for how long it has been so without a break, as far as that was seen."""

    dt_s: float
    """Since the moment before."""
    regulating: bool
    setpoint_kPa: float
    cv_kPa: float
    """The middle one of three readings: a single glitch is none."""
    cv_read_kPa: float
    bottle_read_kPa: float
    filling: bool
    """The inflation valve is told open, if only so little that nothing need flow."""
    least_inflow_SL: float
    """What has gone into the vine since the moment before, for sure."""
    most_outflow_SL: float
    """What the valves may have taken out of the bottle since then."""
    venting_s: float
    """The outlet told open and the inflation valve told shut."""
    sealed_s: float
    """Every valve told shut."""
    outlet_shut_s: float
    """The outlet told shut."""
    resting_s: float
    """Vented, nothing asked for, the Venturi off."""
    holding_s: float
    """Regulating at a setpoint that does not move."""


class Reader:
    """Makes moments of telemetry."""

    def __init__(self, rig: Expected) -> None:
        self._rig = rig
        self._readings: deque[float] = deque(maxlen=3)
        self._told: deque[tuple[float, float, float]] = deque()
        """When, EVP, DVP: of the last `VALVE_LAG_S`."""
        self._t = 0.0
        self._setpoint = 0.0
        self._venting_s = self._sealed_s = self._outlet_shut_s = self._resting_s = self._holding_s = 0.0

    def read(self, dt_s: float, telemetry: Telemetry, gap: bool = False) -> Moment:
        """The next moment, `dt_s` after the last one. After a gap nobody knows what lasted, but for an outlet
        that is shut again: the vine has still its air, or shows that it has not."""
        self._readings.append(telemetry.cv_kPa)
        cv_kPa = sorted(self._readings)[len(self._readings) // 2]
        evp, dvp = telemetry.evp_opening, telemetry.dvp_opening
        self._t += dt_s
        # What was told before is there in any case: it held until now, or it did not.
        earliest_s = min(self._t - VALVE_LAG_S, self._told[-1][0] if self._told else self._t)
        self._told.append((self._t, evp, dvp))
        while self._told[0][0] < earliest_s:
            self._told.popleft()
        _, evps, dvps = zip(*self._told, strict=True)
        least_evp = min(evps) if self._t >= VALVE_LAG_S else 0.0
        bottle_kPa = telemetry.reservoir_kPa

        def lasting(seconds: float, so: bool, bridged: bool = False) -> float:
            if not so:
                return 0.0
            return JUST_S if gap and not (bridged and seconds > 0.0) else seconds + dt_s

        regulating = telemetry.mode is Mode.REGULATE
        asked = regulating and telemetry.setpoint_kPa > 0.0
        self._venting_s = lasting(self._venting_s, telemetry.solenoid and evp == 0.0)
        self._sealed_s = lasting(self._sealed_s, not telemetry.solenoid and evp == dvp == 0.0)
        self._outlet_shut_s = lasting(self._outlet_shut_s, not telemetry.solenoid, bridged=True)
        self._resting_s = lasting(self._resting_s, telemetry.solenoid and evp == dvp == 0.0 and not asked)
        steady = asked and telemetry.setpoint_kPa == self._setpoint
        self._holding_s = lasting(self._holding_s, steady and dvp == 0.0)
        self._setpoint = telemetry.setpoint_kPa
        return Moment(
            dt_s=dt_s,
            regulating=regulating,
            setpoint_kPa=telemetry.setpoint_kPa,
            cv_kPa=cv_kPa,
            cv_read_kPa=telemetry.cv_kPa,
            bottle_read_kPa=bottle_kPa,
            filling=evp > 0.0,
            least_inflow_SL=dt_s * self._rig.least_inflow_SL_per_s(least_evp, bottle_kPa, cv_kPa),
            most_outflow_SL=dt_s * self._rig.most_outflow_SL_per_s(max(evps), max(dvps), bottle_kPa),
            venting_s=self._venting_s,
            sealed_s=self._sealed_s,
            outlet_shut_s=self._outlet_shut_s,
            resting_s=self._resting_s,
            holding_s=self._holding_s,
        )
