"""Pressure and air along a mission: the cost of each vine item, and safety's ruling on it.

This module has no model of its own. The code that runs in flight plans the motions, judges the intents and
counts the air. The service's reservoir estimator reads the planned motions instead of telemetry.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

from flying_vines.config.config import Config
from flying_vines.core.events import Decision
from flying_vines.core.motion_planner import MotionPlanner
from flying_vines.core.safety import Ruling, Safety, SafetyInputs
from flying_vines.physics.gas import STANDARD_TEMPERATURE_K
from flying_vines.supply import CyclesLeft, ReservoirEstimate, RigPrior
from flying_vines.supply.air_use import BLOCK_S, FLAT_KPA
from flying_vines.supply.cycles_left import READING_SD_KPA, Z90
from flying_vines.supply.reservoir_filter import GAS, ReservoirFilter, Spent, X
from flying_vines.vehicle.mission.item import MissionItem
from flying_vines.vehicle.triggers import Rules
from flying_vines.vine.intent import Intent
from flying_vines.vine.motion import Motion
from missions.timeline import ENDS, Timeline, TimelineStep

WATCHED_S = 60.0
"""Assumption: before take-off the service has read the pressure of the reservoir at rest for this time."""
STILL_S = 5.0
"""Time step while the vine is at rest."""


class Range(NamedTuple):
    """Gauge kPa: expected value and 90 % interval."""

    expected: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class PlannedBend:
    """One vine item of the mission, and its cost."""

    step: TimelineStep
    intent: Intent | None
    ruling: Ruling
    """Safety's ruling at the expected reservoir pressure; "refused" also if the item has no valid intent."""
    doubt: str
    """Why safety would refuse the item at the low end of the reservoir's interval. Empty if safety would not
    refuse it then, or refuses it already at the expected pressure."""
    motion: Motion | None
    ends_s: float
    """End of the motion: vine at rest, next item that is not refused, or landing, whichever is first."""
    bent_s: float
    """Time under pressure."""
    before: Range
    after: Range
    air_kPa: float
    """Expected pressure loss of the reservoir."""
    cycles: CyclesLeft | None
    """Cycles left after the bend."""
    low_at_s: float | None = None
    """When the reservoir falls below the reserve during this bend; safety then vents the vine."""


@dataclass(frozen=True, slots=True)
class AirBudget:
    """The air budget of the whole mission."""

    bends: tuple[PlannedBend, ...]
    begins: Range
    ends: Range
    length_s: float
    bent_at_end: PlannedBend | None
    """The bend that still lasts when the landing begins or the mission ends; None if the vine is straight."""


@dataclass(frozen=True, slots=True)
class FlightResult:
    """The result of one flight; pressures are gauge."""

    ran: tuple[MissionItem, ...]
    """The vine items that the autopilot ran, in order."""
    decisions: tuple[Decision, ...]
    """The service's decisions about them."""
    begins_kPa: float
    ends_kPa: float
    length_s: float
    """Simulated time from the start of the mission to the landing, or until the flight was stopped."""
    landed: bool
    flown_s: float
    """`length_s` and the time on the ground before it."""
    took_s: float
    """Real time on this computer."""

    @property
    def speed(self) -> float:
        """Simulated time divided by real time."""
        return self.flown_s / max(1e-9, self.took_s)


def budget(plan: Timeline, config: Config, prior: RigPrior, reservoir_kPa: float) -> AirBudget:
    """The budget for a reservoir at `reservoir_kPa` (gauge) at take-off."""
    return _MissionRun(plan, config, prior, reservoir_kPa).run()


class _Air:
    """Predicts the reservoir's pressure."""

    def __init__(self, prior: RigPrior, reservoir_kPa: float) -> None:
        self._prior = prior
        self._filter = ReservoirFilter(prior, reservoir_kPa)
        for _ in range(round(WATCHED_S / BLOCK_S)):
            self._filter.spend(Spent(BLOCK_S, 0.0, 0.0, 0.0, 0.0))
            self._filter.read(self._reading(), READING_SD_KPA)
        self._filter.mean[X] += reservoir_kPa - self._reading()

    def spend(self, spent: Spent) -> None:
        self._filter.spend(spent)

    def range_kPa(self) -> Range:
        p, slope = self._filter.covariance, self._kPa_per_K()
        sd = math.sqrt(max(0.0, p[X][X] - 2.0 * slope * p[X][GAS] + slope * slope * p[GAS][GAS]))
        expected = self._reading()
        return Range(expected, max(0.0, expected - Z90 * sd), expected + Z90 * sd)

    def estimate(self) -> ReservoirEstimate:
        """The estimate that the service would have now."""
        estimate = ReservoirEstimate(self._prior)
        estimate.filter = self._filter
        return estimate

    def _reading(self) -> float:
        """The gauge reading, which is lower for cold gas."""
        return self._filter.mean[X] - self._kPa_per_K() * self._filter.mean[GAS]

    def _kPa_per_K(self) -> float:
        """Change of the reading per kelvin of the gas."""
        return self._filter.absolute_kPa / STANDARD_TEMPERATURE_K


class _MissionRun:
    def __init__(self, plan: Timeline, config: Config, prior: RigPrior, reservoir_kPa: float) -> None:
        self._plan = plan
        self._config = config
        self._prior = prior
        self._rules = Rules(config)
        self._safety = Safety(config)
        self._planner = MotionPlanner(config)
        self._air = _Air(prior, reservoir_kPa)
        self._t_s = 0.0
        self._motion: Motion | None = None
        self._bent_kPa = 0.0
        self._low_at_s: float | None = None

    def run(self) -> AirBudget:
        begins = self._air.range_kPa()
        steps = [step for step in self._plan.steps if step.item.command in self._rules.commands]
        landing_s = self._landing_s()
        bends: list[PlannedBend] = []
        held: int | None = None
        for i, step in enumerate(steps):
            until_s = min(landing_s, steps[i + 1].t_s if i + 1 < len(steps) else math.inf)
            self._advance(step.t_s)
            bends.append(self._bend(step))
            if bends[i].ruling.verdict != "refused":
                held = i
            if held is not None and self._motion is not None:
                bends[held] = self._followed(bends[held], self._motion, until_s)
            self._advance(until_s)
            if held is not None and self._low_at_s is not None:
                bends[held] = replace(bends[held], low_at_s=self._low_at_s)
                self._low_at_s = None
                self._vent()
        bent = self._motion is not None and self._motion.stays_bent
        self._vent()
        self._advance(self._plan.length_s)
        return AirBudget(
            tuple(bends),
            begins,
            self._air.range_kPa(),
            self._plan.length_s,
            bends[held] if bent and held is not None else None,
        )

    def _landing_s(self) -> float:
        """Start of the last item if it is a landing or return, else the end of the mission.

        The budget vents the vine then. In flight the altitude interlock vents it later, near the ground.
        """
        last = self._plan.steps[-1] if self._plan.steps else None
        return self._plan.length_s if last is None or last.item.command not in ENDS else last.t_s

    def _bend(self, step: TimelineStep) -> PlannedBend:
        """Judge an item, and begin its motion if it is not refused."""
        intent, problem = self._rules.for_command(step.item.command, step.item.params)
        if intent is not None and not problem:
            problem = self._planner.problem(intent)
        before, cycles = self._air.range_kPa(), self._air.estimate().cycles_left()
        ruling, doubt, motion = Ruling("refused", problem), "", None
        if intent is not None and not problem:
            motion = self._planned(intent)
            ruling = self._judge(motion, step.height_m, before.expected)
            if ruling.verdict != "refused":
                worst = self._judge(motion, step.height_m, before.low)
                doubt = worst.reason if worst.verdict == "refused" else ""
                if ruling.rate_scale < 1.0:
                    motion = self._planned(intent, ruling.rate_scale)
                self._motion, self._bent_kPa = replace(motion, started_at=step.t_s), motion.bent_kPa
        return PlannedBend(step, intent, ruling, doubt, motion, step.t_s, 0.0, before, before, 0.0, cycles)

    def _followed(self, bend: PlannedBend, motion: Motion, until_s: float) -> PlannedBend:
        """The bend with what its motion does until `until_s`. A refused item does not end it."""
        lasts_s = max(0.0, until_s - bend.step.t_s)
        moves_s = min(motion.duration_s, lasts_s)
        ends_s = bend.step.t_s + moves_s
        bend = replace(bend, bent_s=lasts_s if motion.stays_bent else moves_s)
        if ends_s <= self._t_s:
            return bend
        self._advance(ends_s)
        after = self._air.range_kPa()
        return replace(
            bend,
            ends_s=ends_s,
            after=after,
            air_kPa=bend.before.expected - after.expected,
            cycles=self._air.estimate().cycles_left(),
        )

    def _planned(self, intent: Intent, rate_scale: float = 1.0) -> Motion:
        start_kPa = self._pressure_kPa()
        return self._planner.plan(intent, start_kPa, self._bent_kPa, rate_scale=rate_scale)

    def _judge(self, motion: Motion, height_m: float, reservoir_kPa: float) -> Ruling:
        air = self._air.estimate().air_needed(motion.rise_kPa, motion.rate_kPa_per_s)
        now = SafetyInputs(
            armed=True,
            altitude_m=height_m,
            autopilot_age_s=0.0,
            firmware_ready=True,
            telemetry_age_s=0.0,
            reservoir_kPa=reservoir_kPa,
        )
        return self._safety.judge(motion, air, now)

    def _pressure_kPa(self, t_s: float | None = None) -> float:
        """The vine's setpoint at a time; default: now."""
        return 0.0 if self._motion is None else self._motion.setpoint_kPa(self._t_s if t_s is None else t_s)

    def _vent(self) -> None:
        pressure = self._pressure_kPa()
        if pressure > 0.0:
            self._air.spend(Spent(0.0, 0.0, 0.0, self._venturi_s(pressure), 0.0))
        self._motion = None
        self._bent_kPa = 0.0

    def _venturi_s(self, fall_kPa: float) -> float:
        return self._prior.cycle_venturi_s * fall_kPa / self._prior.pneumatics.cycle_swing_kPa

    def _advance(self, to_s: float) -> None:
        """Advance the time, and count the air."""
        for spent in self._spent(to_s):
            self._air.spend(spent)
            reading = self._air.range_kPa().expected
            low = reading < self._config.interlocks.reserve_kPa and self._pressure_kPa() > FLAT_KPA
            if low and self._low_at_s is None:
                self._low_at_s = self._t_s

    def _spent(self, to_s: float) -> Iterator[Spent]:
        """The air used until `to_s`, in steps of BLOCK_S while the vine moves, else in steps of STILL_S."""
        while self._t_s < to_s - 1e-9:
            moves = self._motion is not None and self._t_s < self._motion.started_at + self._motion.duration_s
            time_s = min(to_s - self._t_s, BLOCK_S if moves else STILL_S)
            was = self._pressure_kPa()
            self._t_s += time_s
            now = self._pressure_kPa()
            flat = 1.0 if was <= FLAT_KPA < now else 0.0
            held_kPa_s = 0.5 * (was + now) * time_s
            yield Spent(time_s, max(0.0, now - was), flat, self._venturi_s(max(0.0, was - now)), held_kPa_s)
