"""Features of telemetry that the estimate, the physics checks and safety share.

EVP: inflation valve (proportional). DVP: valve that supplies the Venturi. CV: control volume, the vine.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

from firmware_link.protocol import Fault, Mode, Telemetry
from flying_vines.supply.rig_prior import RigPrior

RESERVOIR_FILTER_S = 0.3
CV_FILTER_S = 0.02
VALVE_LAG_S = 0.06
"""Total delay from a valve command to the sensor's reading."""
JUST_S = 0.001
"""Duration of a state that was first seen after a gap; above 0, so that it counts as present."""
MAX_GAP_S = 0.11
"""After a longer gap, by the board's clock, the valve commands in between are unknown. At 10 Hz a message
comes every 0.1 s, plus or minus one step of the board's loop."""
MAX_BRIDGED_S = 0.5
"""After a longer gap the durations of all states are reset, and the air used in the gap is not known."""
SPIKE_KPA = 25.0
"""A reading of the reservoir further from the median of the last three is a spike, or the first of a new
level. So it counts one message later. A burst reservoir falls by less in 10 ms."""
REPEATS = Fault.CV_SENSOR | Fault.RESERVOIR_SENSOR
"""With one of these faults the firmware repeats the last valid reading."""
_CLOCK_MS = 1 << 32

Continuity = Literal["none", "broken", "gap", "follows"]


class Features(NamedTuple):
    """One telemetry message, and features of this message and those before it. Gauge kPa.

    The checks use the board's clock, because messages may arrive in bursts.
    """

    t: float
    """Arrival time of the message."""
    telemetry: Telemetry
    """Without spikes of the reservoir's reading."""
    armed: bool
    """The vehicle is armed."""
    reservoir_kPa: float | None
    """The reading with the sensor's gain and offset corrected; None if it is not valid."""
    reservoir_smooth_kPa: float | None
    """`reservoir_kPa`, smoothed; None before the first one."""
    cv_lower_kPa: float
    """Minimum of the last two readings, which removes one high glitch. NaN until there are two."""
    cv_smooth_kPa: float
    """Lightly filtered (20 ms); valid only if `complete`."""
    complete: bool
    """Both pressures are known."""
    dt_s: float
    """Time since the last complete message, by the host's clock."""
    continuity: Continuity
    """By the board's clock. "none": the first message, or the same time again. "broken": after a long gap or
    with a faulty sensor, so the state before is unknown. "gap": a message is missing, so the valve commands
    in between are unknown."""
    device_dt_s: float
    """Time since the last message, by the board's clock."""
    cv_median_kPa: float
    """Median of three readings, which removes one glitch."""
    # Commanded openings within `VALVE_LAG_S`.
    min_evp: float
    max_evp: float
    max_dvp: float
    regulating: bool
    # The time for which each state has lasted, as far as telemetry shows.
    venting_s: float
    """Outlet commanded open and inflation valve shut."""
    sealed_s: float
    """Every valve commanded shut."""
    outlet_shut_s: float
    """Outlet commanded shut."""
    resting_s: float
    """Vine vented, no setpoint, Venturi off."""
    holding_s: float
    """Regulated at a constant setpoint."""


class _States:
    """The time for which each state of the valves has lasted, by the board's clock."""

    def __init__(self) -> None:
        self.cv_kPa: deque[float] = deque(maxlen=3)
        self.openings: deque[tuple[float, float, float]] = deque()
        """(time, EVP, DVP) of the last `VALVE_LAG_S`."""
        self.t = 0.0
        self.setpoint_kPa = 0.0
        self.venting_s = self.sealed_s = self.outlet_shut_s = self.resting_s = self.holding_s = 0.0

    def update(self, dt_s: float, telemetry: Telemetry, gap: bool) -> None:
        """After a gap all times restart, except `outlet_shut_s`: the pressure shows if the outlet opened."""
        evp, dvp = telemetry.evp_opening, telemetry.dvp_opening
        self.cv_kPa.append(telemetry.cv_kPa)
        self.t += dt_s
        # The previous command is valid until this message.
        earliest_s = min(self.t - VALVE_LAG_S, self.openings[-1][0] if self.openings else self.t)
        self.openings.append((self.t, evp, dvp))
        while self.openings[0][0] < earliest_s:
            self.openings.popleft()

        solenoid, shut = telemetry.solenoid, evp == dvp == 0.0
        setpoint = telemetry.mode is Mode.REGULATE and telemetry.setpoint_kPa > 0.0
        steady = setpoint and telemetry.setpoint_kPa == self.setpoint_kPa
        if gap:
            self.venting_s = self.sealed_s = self.resting_s = self.holding_s = 0.0
        step_s = JUST_S if gap else dt_s
        self.venting_s = self.venting_s + step_s if solenoid and evp == 0.0 else 0.0
        self.sealed_s = self.sealed_s + step_s if shut and not solenoid else 0.0
        self.resting_s = self.resting_s + step_s if shut and solenoid and not setpoint else 0.0
        self.holding_s = self.holding_s + step_s if steady and dvp == 0.0 else 0.0
        outlet_step_s = dt_s if self.outlet_shut_s > 0.0 else step_s
        self.outlet_shut_s = 0.0 if solenoid else self.outlet_shut_s + outlet_step_s
        self.setpoint_kPa = telemetry.setpoint_kPa


class TelemetryReader:
    """Computes the features of each telemetry message."""

    def __init__(self, prior: RigPrior) -> None:
        self._prior = prior
        self._reservoir_smooth_kPa: float | None = None
        self._reservoir_at = 0.0
        self._reservoir_readings: deque[float] = deque(maxlen=3)
        self._cv_kPa = math.nan
        self._cv_smooth_kPa = math.nan
        self._complete_at: float | None = None
        self._device_time_ms: int | None = None
        self._states = _States()

    def read(self, t: float, telemetry: Telemetry, armed: bool = False) -> Features:
        """The features of a message that arrived at time `t`."""
        telemetry = self._without_spike(telemetry)
        reservoir_kPa = self._read_reservoir(t, telemetry)
        lower_kPa, self._cv_kPa = min(self._cv_kPa, telemetry.cv_kPa), telemetry.cv_kPa
        complete = self._reservoir_smooth_kPa is not None and math.isfinite(telemetry.cv_kPa)
        dt_s = 0.0
        if complete:
            dt_s = 0.0 if self._complete_at is None else max(0.0, t - self._complete_at)
            smooth_kPa = telemetry.cv_kPa if self._complete_at is None else self._cv_smooth_kPa
            self._cv_smooth_kPa = smooth_kPa + (telemetry.cv_kPa - smooth_kPa) * dt_s / (CV_FILTER_S + dt_s)
            self._complete_at = t
        continuity, device_dt_s = self._read_clock(telemetry)
        states = self._states
        evps: Sequence[float] = (0.0,)
        dvps: Sequence[float] = (0.0,)
        if continuity in ("gap", "follows"):
            states.update(device_dt_s, telemetry, continuity == "gap")
            _, evps, dvps = zip(*states.openings, strict=True)
        return Features(
            t=t,
            telemetry=telemetry,
            armed=armed,
            reservoir_kPa=reservoir_kPa,
            reservoir_smooth_kPa=self._reservoir_smooth_kPa,
            cv_lower_kPa=lower_kPa,
            cv_smooth_kPa=self._cv_smooth_kPa,
            complete=complete,
            dt_s=dt_s,
            continuity=continuity,
            device_dt_s=device_dt_s,
            cv_median_kPa=sorted(states.cv_kPa)[len(states.cv_kPa) // 2] if states.cv_kPa else math.nan,
            min_evp=min(evps) if states.t >= VALVE_LAG_S else 0.0,
            max_evp=max(evps),
            max_dvp=max(dvps),
            regulating=telemetry.mode is Mode.REGULATE,
            venting_s=states.venting_s,
            sealed_s=states.sealed_s,
            outlet_shut_s=states.outlet_shut_s,
            resting_s=states.resting_s,
            holding_s=states.holding_s,
        )

    def _without_spike(self, telemetry: Telemetry) -> Telemetry:
        readings = self._reservoir_readings
        readings.append(telemetry.reservoir_kPa)
        middle_kPa = sorted(readings)[len(readings) // 2]
        if len(readings) < 3 or abs(telemetry.reservoir_kPa - middle_kPa) <= SPIKE_KPA:
            return telemetry
        return replace(telemetry, reservoir_kPa=middle_kPa)

    def _read_reservoir(self, t: float, telemetry: Telemetry) -> float | None:
        # `&` of flags takes a microsecond, and there are almost never faults.
        faulty = telemetry.faults and telemetry.faults & Fault.RESERVOIR_SENSOR
        if faulty or not math.isfinite(telemetry.reservoir_kPa):
            return None
        reservoir_kPa = self._prior.reservoir_kPa(telemetry.reservoir_kPa)
        if self._reservoir_smooth_kPa is None:
            self._reservoir_smooth_kPa = reservoir_kPa
        weight = 1.0 - math.exp(-max(0.0, t - self._reservoir_at) / RESERVOIR_FILTER_S)
        self._reservoir_smooth_kPa += weight * (reservoir_kPa - self._reservoir_smooth_kPa)
        self._reservoir_at = t
        return reservoir_kPa

    def _read_clock(self, telemetry: Telemetry) -> tuple[Continuity, float]:
        before_ms, self._device_time_ms = self._device_time_ms, telemetry.device_time_ms
        if before_ms is None:
            return "none", 0.0
        dt_s = (telemetry.device_time_ms - before_ms) % _CLOCK_MS / 1000.0
        if dt_s > MAX_BRIDGED_S or (telemetry.faults and telemetry.faults & REPEATS):
            self._states = _States()
            return "broken", dt_s
        if dt_s == 0.0:
            return "none", 0.0
        return "gap" if dt_s > MAX_GAP_S else "follows", dt_s
