"""What telemetry shows of the supply: the air left, the cycles left, and hardware faults.

Each part may fail alone (`isolated_parts`). Only a phloSAR has a reservoir to estimate. Another actuator has
only the checks of installed packages.
"""

from __future__ import annotations

import math
from collections.abc import Container
from functools import partial

from firmware_link.protocol import Telemetry
from flying_vines.config.config import Config
from flying_vines.core.events import KeepLearned
from flying_vines.core.isolated_parts import IsolatedParts
from flying_vines.supply import (
    CyclesLeft,
    Features,
    ReportedCycles,
    ReservoirEstimate,
    RigPrior,
    TelemetryReader,
)
from flying_vines.supply.cycles_left import AirNeeded
from flying_vines.supply.learned_file import learned_from, text_of
from flying_vines.supply.physics_checks import (
    AIR_LOSSES,
    CHECKS,
    Expected,
    PhysicsChecks,
    PhysicsFinding,
    ReservoirSensor,
    expected,
    own_checks,
)
from flying_vines.vehicle.notice import Notice, Severity

CYCLES_EVERY_S = 2.0
"""Interval of the predictions of cycles left. A prediction takes milliseconds of the loop's time."""

FORGOTTEN = -1.0
"""Instead of the number of stored cycles: nothing is stored."""

KEEP_EVERY_S = 10.0
"""Minimum interval between two writes of the learned air to disk."""

SENSOR = "reservoir_sensor"
"""While this check finds something, the cycles left are unknown."""

NO_AIR_NEEDED = AirNeeded(0.0, 0.0)
"""For an actuator without a reservoir."""

AIR_UNKNOWN = AirNeeded(math.inf, math.inf)
"""Used after the estimate has failed: no reservoir has so much air, so every bend is refused."""


def _as_it_is(sensor: ReservoirSensor, _: Expected) -> ReservoirSensor:
    return sensor


class SupplyMonitor:
    """Call `read` and `find` for each telemetry message, and `tick` at each tick.

    `learned` is the text that the last run stored.
    """

    def __init__(self, config: Config, prior: RigPrior, learned: str, parts: IsolatedParts) -> None:
        self.has_reservoir = config.firmware.is_phlosar
        self.features: Features | None = None
        """The features of the latest telemetry."""
        self._prior = prior
        self._parts = parts
        self._reader = TelemetryReader(prior)
        known, self._learned_problem = learned_from(learned, prior)
        self.reservoir = ReservoirEstimate(prior, known)
        self._kept_cycles = self.reservoir.measured_cycles
        """The number of measured cycles that was stored last; NaN after an event, to store the air again."""
        self._kept_at = -math.inf
        self._sensor = ReservoirSensor(expected(prior, config.checks), self.reservoir)
        checks = CHECKS | {SENSOR: partial(_as_it_is, self._sensor)}
        self._checks = PhysicsChecks(prior, config.checks, checks if self.has_reservoir else {})
        self._own_checks = own_checks(prior, config.checks)
        self._own_levels = config.checks.own
        self._cycles = ReportedCycles(self.reservoir)
        self._cycles_at = -math.inf
        self._low_warned = False

    def read(self, t: float, telemetry: Telemetry, armed: bool) -> Features:
        features = self.features = self._reader.read(t, telemetry, armed)
        return features

    def find(self, t: float, features: Features) -> list[PhysicsFinding]:
        """Update the estimate, and run the physics checks. Returns their new findings."""
        run = self._parts.run
        none: list[PhysicsFinding] = []
        if self.has_reservoir:
            run(t, "reservoir estimate", lambda: self.reservoir.update(features), None, needed=True)
        found = run(t, "physics checks", lambda: self._checks.take(features), none, needed=True)
        for name, checks in self._own_checks.items():
            needed = self._own_levels[name] == "fault"
            found = found + run(t, f"check {name}", partial(checks.take, features), none, needed)
        return found

    @property
    def sensor_in_doubt(self) -> bool:
        """The reservoir's sensor is wrong, so the air left is unknown."""
        return SENSOR in self._checks.present

    def believe_sensor(self, seen_at: float) -> None:
        """A person says that the reservoir's sensor is right, if they have seen that it was in doubt."""
        if self.sensor_in_doubt and self._sensor.found_at <= seen_at:
            self._sensor.clear()
            del self._checks.present[SENSOR]

    @property
    def faults(self) -> dict[str, str]:
        """A sentence for each check that finds a fault, by name."""
        faults = self._checks.faults
        for checks in self._own_checks.values():
            faults |= checks.faults
        return faults

    @property
    def findings(self) -> dict[str, int]:
        """The number of findings of each check."""
        return dict(sum((checks.counts for checks in self._own_checks.values()), self._checks.counts))

    @property
    def cycles_left(self) -> CyclesLeft | None:
        return self._cycles.left

    def air_needed(self, t: float, rise_kPa: float, rate_kPa_per_s: float) -> AirNeeded:
        """See `ReservoirEstimate.air_needed`."""
        if not self.has_reservoir:
            return NO_AIR_NEEDED
        needed = partial(self.reservoir.air_needed, rise_kPa, rate_kPa_per_s)
        return self._parts.run(t, "reservoir estimate", needed, AIR_UNKNOWN, needed=True)

    def tick(
        self, t: float, faults: Container[str], low_reservoir_cycles: float
    ) -> list[Notice | KeepLearned]:
        """Predict the cycles left. Returns texts for the pilot, and the learned air for the next run.

        `faults`: the names of the present losses and latched faults.
        """
        outputs: list[Notice | KeepLearned] = []
        if self.has_reservoir and (event := self._update_cycles_left(t, faults)):
            self._kept_cycles = math.nan
            outputs.append(Notice(t, Severity.NOTICE, f"Vine: {event}"))
        if text := self._low_reservoir(low_reservoir_cycles):
            outputs.append(Notice(t, Severity.WARNING, f"Vine: {text}"))
        if self._learned_problem:
            outputs.append(Notice(t, Severity.NOTICE, f"Vine: {self._learned_problem}"))
            self._learned_problem = ""
        if (learned := self._changed(t)) is not None:
            outputs.append(KeepLearned(t, learned))
        return outputs

    def _update_cycles_left(self, t: float, faults: Container[str]) -> str:
        """Predict the cycles left after every flown cycle, and every `CYCLES_EVERY_S`.

        Returns the event that changed the cycles left, as text; empty without an event.
        """
        reservoir, cycles = self.reservoir, self._cycles
        lost = any(name in faults for name in AIR_LOSSES)
        flown = cycles.left is None or cycles.left.measured_cycles != reservoir.measured_cycles
        in_doubt = self.sensor_in_doubt
        changed = (lost, in_doubt) != (cycles.lost, cycles.in_doubt)
        if not (flown or changed or abs(reservoir.read_at - self._cycles_at) >= CYCLES_EVERY_S):
            return ""
        self._cycles_at = reservoir.read_at
        armed = self.features is not None and self.features.armed
        event = self._parts.run(t, "cycles left", lambda: cycles.update(t, lost, in_doubt, armed), None)
        if event is None:
            cycles.left = None
        return event or ""

    def _low_reservoir(self, threshold: float) -> str:
        """The text when the cycles left fall below the threshold; the next one only after a clear rise."""
        cycles = self.cycles_left
        if cycles is None or cycles.lost:
            return ""
        if cycles.expected < threshold and not self._low_warned:
            self._low_warned = True
            return f"reservoir low, {self.reservoir.reservoir_kPa:.0f} kPa, {cycles}"
        if cycles.expected > 1.5 * threshold + 1:
            self._low_warned = False
        return ""

    def _changed(self, t: float) -> str | None:
        """The learned air as text, if it must be stored now; empty text to forget it.

        It must be stored after new cycles or an event, at most once in `KEEP_EVERY_S`. What a wrong sensor
        has taught is forgotten.
        """
        reservoir = self.reservoir
        if self._cycles.in_doubt:
            forgotten, self._kept_cycles = self._kept_cycles == FORGOTTEN, FORGOTTEN
            return None if forgotten else ""
        if reservoir.measured_cycles == self._kept_cycles or t < self._kept_at + KEEP_EVERY_S:
            return None
        learned = reservoir.learned
        if learned is None:
            return None
        self._kept_cycles, self._kept_at = reservoir.measured_cycles, t
        return text_of(self._prior, learned)
