"""The commands of a run over time: setpoints for the regulator, or valve openings."""

from __future__ import annotations

import math
import random
from bisect import bisect_right
from collections.abc import Callable, Iterator
from itertools import accumulate

from flying_vines.physics.baseline import Inputs
from flying_vines.simulation.scenario.run_kinds import (
    BendsRun,
    ChirpRun,
    DischargeRun,
    OpeningsRun,
    PrbsRun,
    ProfileRun,
    RunKind,
    SineRun,
    StepsRun,
    Valves,
)

SetpointOverTime = Callable[[float], float]
"""Setpoint (kPa gauge) as a function of time (s)."""
ValveCommand = Callable[[float, float], Inputs]
"""Openings as a function of time (s) and the control volume's reading (kPa). Called once per sample."""

_SLACK_S = 1e-9
"""Tolerance for rounding, so that a change at the time of a sample acts in this sample."""
_VENTURI_LEVELS = (0.0, 0.5, 1.0)


def command_of(run: RunKind, pattern: random.Random) -> SetpointOverTime | None:
    """The setpoint of a run; None if the run does not regulate."""
    match run:
        case StepsRun():
            return _held(run.pressures_kPa, run.holds_s)
        case BendsRun():
            holds_s = (run.hold_s, run.rest_s) * run.cycles
            return _held((run.bend_kPa, 0.0) * run.cycles, holds_s)
        case SineRun():
            return _swing(run.low_kPa, run.high_kPa, lambda t_s: run.frequency_Hz * t_s)
        case ChirpRun():
            return _swing(run.low_kPa, run.high_kPa, lambda t_s: chirp_cycles(run, t_s))
        case PrbsRun(levels_kPa=levels) if levels:
            drawn = list(_draw(run, levels, pattern))
            return _held([level for level, _ in drawn], [hold_s for _, hold_s in drawn])
        case ProfileRun():
            return run.motion().setpoint_kPa
    return None


def valves_of(run: RunKind, pattern: random.Random) -> ValveCommand | None:
    """The openings of a run; None if the run regulates."""
    match run:
        case DischargeRun():
            drive = Inputs(run.opening, 0.0, True) if run.valve == "evp" else Inputs(0.0, run.opening, False)
            return lambda t_s, cv_kPa: drive
        case OpeningsRun():
            return _Sequence(run.valves)
        case PrbsRun(levels_opening=levels) if levels:
            return _RandomValves(run, pattern)
    return None


def chirp_cycles(run: ChirpRun, t_s: float) -> float:
    """Number of cycles of a chirp until `t_s`: the integral of its frequency."""
    ratio = run.to_Hz / run.from_Hz
    if run.sweep == "linear" or math.isclose(ratio, 1.0, rel_tol=1e-9):
        return run.from_Hz * t_s + 0.5 * (run.to_Hz - run.from_Hz) * t_s**2 / run.duration_s
    log_ratio = math.log(ratio)
    return run.from_Hz * run.duration_s / log_ratio * math.expm1(log_ratio * t_s / run.duration_s)


def _swing(low_kPa: float, high_kPa: float, cycles: Callable[[float], float]) -> SetpointOverTime:
    half = 0.5 * (high_kPa - low_kPa)
    return lambda t_s: low_kPa + half * (1.0 - math.cos(2.0 * math.pi * cycles(t_s)))


def _held(
    levels: list[float] | tuple[float, ...], holds_s: list[float] | tuple[float, ...]
) -> SetpointOverTime:
    ends_s = list(accumulate(holds_s))
    return lambda t_s: levels[min(bisect_right(ends_s, t_s + _SLACK_S), len(levels) - 1)]


def _draw(run: PrbsRun, levels: tuple[float, ...], pattern: random.Random) -> Iterator[tuple[float, float]]:
    """Random levels and hold times until the end of the run; no level twice in a row."""
    level = None
    begin_s = 0.0
    while begin_s < run.duration_s:
        level = pattern.choice([other for other in levels if other != level])
        hold_s = pattern.uniform(run.min_hold_s, run.max_hold_s)
        yield level, hold_s
        begin_s += hold_s


class _Sequence:
    """A sequence of openings."""

    def __init__(self, valves: tuple[Valves, ...]) -> None:
        self._valves = valves
        self._at = 0
        self._ends_s = valves[0].for_s

    def __call__(self, t_s: float, cv_kPa: float) -> Inputs:
        while self._at < len(self._valves) - 1 and self._is_over(t_s, cv_kPa):
            left_early = t_s + _SLACK_S < self._ends_s
            self._at += 1
            self._ends_s = (t_s if left_early else self._ends_s) + self._valves[self._at].for_s
        now = self._valves[self._at]
        return Inputs(now.evp, now.dvp, now.solenoid)

    def _is_over(self, t_s: float, cv_kPa: float) -> bool:
        until_kPa = self._valves[self._at].until_kPa
        return t_s + _SLACK_S >= self._ends_s or (until_kPa is not None and cv_kPa >= until_kPa)


class _RandomValves:
    """Random openings, drawn one by one, because the next one depends on the control volume's pressure."""

    def __init__(self, run: PrbsRun, pattern: random.Random) -> None:
        self._run = run
        self._pattern = pattern
        self._drive = Inputs(0.0, 0.0, False)
        self._ends_s = 0.0

    def __call__(self, t_s: float, cv_kPa: float) -> Inputs:
        full = cv_kPa >= self._run.most_kPa
        while t_s + _SLACK_S >= self._ends_s:
            self._ends_s += self._pattern.uniform(self._run.min_hold_s, self._run.max_hold_s)
            self._drive = self._next(full)
        if full and self._drive.evp > 0.0:
            self._drive = Inputs(0.0, 0.0, False)
        return self._drive

    def _next(self, full: bool) -> Inputs:
        run, pattern, last = self._run, self._pattern, self._drive
        # All three numbers are always drawn, so that one reading does not change all later openings.
        vent = pattern.random() < run.vent_share
        venturi = pattern.choice(_VENTURI_LEVELS)
        level = pattern.choice([other for other in run.levels_opening if other != last.evp or last.solenoid])
        return Inputs(0.0, venturi, True) if vent or full else Inputs(level, 0.0, False)
