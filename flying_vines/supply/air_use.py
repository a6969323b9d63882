"""Finds in telemetry the uses of air, the times when the reservoir can be read, and each inflation.

CV: control volume, the vine. Pouch: the bending pouch of the actuator.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from firmware_link.protocol import Telemetry
from flying_vines.physics.plant.flow import Opening, choked_share
from flying_vines.supply.reservoir_filter import Spent
from flying_vines.supply.rig_prior import AMBIENT_KPA, RigPrior
from flying_vines.supply.telemetry_features import MAX_BRIDGED_S, Features

BLOCK_S = 0.1
"""Averaging time of a reading of the reservoir."""
SETPOINT_TURN_KPA = 1.0
CV_TURN_KPA = 1.5
"""A smaller change is noise, not a turn."""
RESTED_S = 0.5
"""A control volume that was vented for this time is at ambient. Its reading is the sensor's zero."""
FLAT_KPA = 0.8
"""A pouch may be flat if the reading is nearer to the sensor's zero than this."""
NEAR_KPA = 1.0
WORKING_OPENING = 0.6
CALM_S = 0.1
MIN_INFLATION_S = 0.01
"""Avoids a duration of zero or less if the clock steps back."""
WIDE_OPEN = 0.95
TRACE = 24
"""Number of setpoints that are stored for an inflation."""
RISEN_S = 0.25
"""A vent within this time after the setpoint last rose cuts the movement off."""
MAX_TRACE = 20_000
"""Maximum number of recorded setpoints: 200 s at 100 Hz. A longer rise is a hold."""


def tolerance_kPa(swing_kPa: float) -> float:
    """An inflation has reached its top if the CV is nearer to the top than this."""
    return max(1.5, 0.1 * swing_kPa)


def driving_kPa(law: Opening, supply_kPa_abs: float, downstream_kPa_abs: float) -> float:
    """The driving pressure of a valve: its flow at ambient temperature, divided by its conductance."""
    if downstream_kPa_abs >= supply_kPa_abs:
        return 0.0
    if law.ohmic:
        return supply_kPa_abs - downstream_kPa_abs
    return supply_kPa_abs * choked_share(law, supply_kPa_abs, downstream_kPa_abs)


@dataclass(frozen=True, slots=True)
class ObservedInflation:
    """One rise of the setpoint, and everything until the next rise. Gauge kPa."""

    low_kPa: float
    top_kPa: float
    given_s: float
    """Time from the start of the rise until the setpoint leaves the top again."""
    valve_kPa_s: float
    """∫ driving pressure · effective opening, until the CV reached its top."""
    partly: float
    """The share of `valve_kPa_s` with an opening below `WIDE_OPEN`."""
    supply_kPa_abs: float
    reached: bool
    setpoints_kPa: tuple[float, ...]
    """Evenly spaced over `given_s`."""
    spent: Spent
    cut_off: bool = False
    """It was vented or replaced before its end. Its air and supply are not those of a whole inflation."""

    @property
    def swing_kPa(self) -> float:
        return self.top_kPa - self.low_kPa

    def as_hard_as(self, other: ObservedInflation) -> bool:
        """True if the swing is at least as large and the time at most as long, within 5 %."""
        return self.swing_kPa > 0.95 * other.swing_kPa and self.given_s < 1.05 * other.given_s


class AirUse:
    """Follows telemetry. `take` sets `block`, `reading_kPa` and `inflation` when they are complete."""

    def __init__(self, prior: RigPrior) -> None:
        self._evp_law = prior.evp_law.numbers()
        self._dead_opening = prior.dead_opening
        self.block: Spent | None = None
        self.unseen_s = 0.0
        """Time in the block that was a gap in telemetry."""
        self.reading_kPa: float | None = None
        """The mean over the block; None if the reservoir could not be read."""
        self.readings = 0
        self.inflation: ObservedInflation | None = None
        self.was_cut_off = False
        """True if a movement was cut off at the latest message."""
        self._begun = False
        self._setpoints: deque[float] = deque(maxlen=3)
        self._setpoint = 0.0
        self._calm_s = 0.0
        self._cv = self._cv_low = self._cv_top = 0.0
        self._cv_rising = False
        self._zero = 0.0
        self._rested_s = 0.0
        self._low = self._from = self._top = 0.0
        self._low_at = 0.0
        self._rising = self._regulating = False
        self._risen_s = 0.0
        """Time since the setpoint last rose."""
        self._began_at: float | None = None
        self._valve_kPa_s = self._partly_kPa_s = 0.0
        self._reached = False
        self._begin_block()
        self._begin_inflation()

    def take(self, features: Features, supply_kPa: float) -> None:
        """Take in one telemetry message. `supply_kPa`: the reservoir's smoothed gauge pressure."""
        self.block = self.reading_kPa = self.inflation = None
        self.was_cut_off = False
        telemetry, dt, self._cv = features.telemetry, features.dt_s, features.cv_smooth_kPa
        if not self._begun:
            self._begun = True
            self._cv_low = telemetry.cv_kPa
        seen_s = dt
        if dt > MAX_BRIDGED_S:
            self._unseen_s += dt
            seen_s = 0.0
        setpoint = self._without_spikes(telemetry.setpoint_kPa, features.regulating)
        rise, flat = self._follow_cv(dt, telemetry, setpoint)
        self._judge_calm(seen_s, telemetry, setpoint)
        self._follow_setpoint(features, setpoint, seen_s, supply_kPa)
        venturi_s, held = telemetry.dvp_opening * seen_s, max(0.0, self._cv) * dt
        for sums in (self._block, self._cycle):
            sums[0] += dt
            sums[1] += rise
            sums[2] += flat
            sums[3] += venturi_s
            sums[4] += held
        if features.reservoir_kPa is not None:
            self._sum_kPa += features.reservoir_kPa
            self._count += 1
        if self._block[0] >= BLOCK_S - 1e-6:
            self._end_block()

    @property
    def cv_kPa(self) -> float:
        """The smoothed reading of the control volume."""
        return self._cv

    def cut_off(self) -> None:
        """The present movement is replaced before its end."""
        if self._rising:
            self._cut_off = True

    def _end_block(self) -> None:
        self.block = Spent(*self._block)
        self.unseen_s = self._unseen_s
        if self._all_calm and self._count:
            self.reading_kPa = self._sum_kPa / self._count
            self.readings = self._count
        self._begin_block()

    def _begin_block(self) -> None:
        self._block = [0.0] * 5
        self._unseen_s = 0.0
        self._sum_kPa = 0.0
        self._count = 0
        self._all_calm = True

    def _without_spikes(self, setpoint: float, regulating: bool) -> float:
        """The median of three: one wrong message is no other bend. A regulation starts anew."""
        if regulating != self._regulating:
            self._setpoints.clear()
        self._setpoints.append(setpoint)
        return sorted(self._setpoints)[(len(self._setpoints) - 1) // 2]

    def _judge_calm(self, dt: float, telemetry: Telemetry, setpoint: float) -> None:
        """Calm: Venturi off, inflation valve open by at most `WORKING_OPENING`, and no rise commanded.

        Then the reservoir's reading and the counted air agree.
        """
        busy = (
            telemetry.dvp_opening > 0.0
            or telemetry.evp_opening > WORKING_OPENING
            or setpoint > max(0.0, self._cv + NEAR_KPA)
            or setpoint > self._setpoint + 1e-3
        )
        self._setpoint = setpoint
        self._calm_s = 0.0 if busy else self._calm_s + dt
        if self._calm_s < CALM_S:
            self._all_calm = False

    def _follow_cv(self, dt: float, telemetry: Telemetry, setpoint: float) -> tuple[float, float]:
        """The rise of the control volume's pressure, and 1 if the rise began from flat (else 0)."""
        cv = self._cv
        if setpoint <= 0.0 and telemetry.solenoid and telemetry.dvp_opening == 0.0:
            self._rested_s += dt
            if self._rested_s > RESTED_S:
                self._zero += (cv - self._zero) * min(1.0, dt / RESTED_S)
        else:
            self._rested_s = 0.0
        if self._cv_rising:
            rise = max(0.0, cv - self._cv_top)
            self._cv_top += rise
            if cv < self._cv_top - CV_TURN_KPA:
                self._cv_rising = False
                self._cv_low = cv
            return rise, 0.0
        self._cv_low = min(self._cv_low, cv)
        if cv <= self._cv_low + CV_TURN_KPA:
            return 0.0, 0.0
        self._cv_rising = True
        self._cv_top = cv
        return cv - self._cv_low, 1.0 if self._cv_low < max(0.0, self._zero) + FLAT_KPA else 0.0

    def _follow_setpoint(self, features: Features, setpoint: float, dt: float, supply_kPa: float) -> None:
        t, telemetry, regulating = features.t, features.telemetry, features.regulating
        if regulating and not self._regulating and not self._rising:
            # Regulation starts at the measured pressure, so the rise is counted from there.
            self._low, self._low_at = setpoint, t
        self._regulating = regulating
        if not self._rising:
            if setpoint <= self._low + 1e-3:
                self._low, self._low_at = min(self._low, setpoint), t
            if setpoint > self._low + SETPOINT_TURN_KPA:
                self._end_inflation()
                self._rising = True
                self._began_at, self._from, self._top = self._low_at, self._low, setpoint
                self._supply_kPa_abs = supply_kPa + AMBIENT_KPA
            return
        self._risen_s = 0.0 if setpoint > self._top + 1e-3 else self._risen_s + dt
        self._top = max(self._top, setpoint)
        if len(self._trace) < MAX_TRACE:
            self._trace.append(setpoint)
        near_kPa = tolerance_kPa(self._top - self._from)
        if setpoint < self._top - near_kPa:
            self._rising = False
            # In VENT and FAULT the setpoint falls to 0, too, perhaps before the movement's end.
            if not regulating and (self._risen_s < RISEN_S or not self._reached):
                self._cut_off = True
            self.was_cut_off = self._cut_off
            self._given_s = max(MIN_INFLATION_S, t - (self._began_at or 0.0))
            self._low, self._low_at = setpoint, t
            return
        opening = telemetry.evp_opening
        effective = max(0.0, (opening - self._dead_opening) / (1.0 - self._dead_opening))
        amount = effective * dt
        if amount > 0.0:
            amount *= driving_kPa(self._evp_law, supply_kPa + AMBIENT_KPA, AMBIENT_KPA + self._cv)
        self._valve_kPa_s += amount
        if opening < WIDE_OPEN:
            self._partly_kPa_s += amount
        self._reached = self._cv >= self._top - near_kPa
        if not self._reached:
            self._needed = (self._valve_kPa_s, self._partly_kPa_s)

    def _end_inflation(self) -> None:
        if self._began_at is not None:
            valve, partly = self._needed
            self.inflation = ObservedInflation(
                low_kPa=self._from,
                top_kPa=self._top,
                given_s=self._given_s,
                valve_kPa_s=valve,
                partly=partly / valve if valve > 0.0 else 1.0,
                supply_kPa_abs=self._supply_kPa_abs,
                reached=self._reached,
                setpoints_kPa=_thinned(self._trace),
                spent=Spent(*self._cycle),
                cut_off=self._cut_off,
            )
        self._begin_inflation()

    def _begin_inflation(self) -> None:
        self._cycle = [0.0] * 5
        self._cut_off = False
        self._given_s = 0.0
        self._supply_kPa_abs = AMBIENT_KPA
        self._trace: list[float] = []
        self._reached = False
        self._valve_kPa_s = self._partly_kPa_s = 0.0
        self._needed = (0.0, 0.0)


def _thinned(values: Sequence[float]) -> tuple[float, ...]:
    step = len(values) / TRACE
    return tuple(values[int((i + 0.5) * step)] for i in range(TRACE)) if values else ()
