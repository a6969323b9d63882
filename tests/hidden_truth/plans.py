"""The inputs of a run, sample by sample: the command for a loop, or the openings of the valves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from hidden_truth.kernel import Array, Control

RUN_S, PERIOD_S = 45.0, 0.02
LEVELS_KPA = (0.0, 7.0, 14.0, 21.0, 35.0, 50.0, 69.0)
BEND_KPA = 20.7
INFLATIONS = (0.15, 0.3, 0.5, 0.75, 1.0)
VENTS, VENT_SHARES = (0.0, 0.5, 1.0), (0.5, 0.25, 0.25)
GUARD_KPA = 60.0
"""Maximum reading up to which random openings inflate."""
HOLD_GUARD_KPA = 100.0
FULL_KPA = 690.0


@dataclass(frozen=True, eq=False)
class Plan:
    """The inputs of one run; `rows` are command (NaN without a loop), EVP, DVP, solenoid."""

    name: str
    time_s: Array
    rows: Array
    control: Control
    reservoir_kPa: float


def steady_time(duration_s: float, period_s: float = PERIOD_S) -> Array:
    """Even sample times, rounded to milliseconds as in the files."""
    time: Array = np.arange(round(duration_s / period_s), dtype=np.float64)
    return (time * period_s).round(3)


def uneven_time(rng: Generator, duration_s: float) -> Array:
    """A host with irregular samples: 6 to 34 ms, and sometimes 0.1 s."""
    n = round(1.2 * duration_s / PERIOD_S)
    gaps = PERIOD_S * rng.uniform(0.3, 1.7, n)
    gaps[rng.random(n) < 0.01] = 0.1
    time: Array = np.concatenate([[0.0], np.cumsum(gaps)]).round(3)
    return time[time < duration_s]


def _rows(time_s: Array) -> Array:
    rows = np.zeros((time_s.size, 4))
    rows[:, 0] = np.nan
    return rows


def _start_kPa(rng: Generator) -> float:
    return float(rng.uniform(430.0, FULL_KPA))


def steps(rng: Generator, time_s: Array, venturi: bool = True) -> Plan:
    """A loop follows random levels that last 1.5 to 6 s."""
    rows = _rows(time_s)
    level, until = 0.0, 0.0
    for i, t in enumerate(time_s):
        if t >= until:
            level = float(rng.choice(LEVELS_KPA[1:] if i == 0 else LEVELS_KPA))
            until = t + rng.uniform(1.5, 6.0)
        rows[i, 0] = level
    return Plan("steps", time_s, rows, Control(True, venturi), _start_kPa(rng))


def prbs(rng: Generator, time_s: Array, venturi: bool = True) -> Plan:
    """Random openings for 6 to 30 samples: inflate, wait, or vent with or without the Venturi."""
    rows = _rows(time_s)
    i = 0
    while i < time_s.size:
        kind = rng.random()
        vent = float(rng.choice(VENTS, p=VENT_SHARES)) if venturi else 0.0
        move = (0.0, 0.0, 0.0)
        if kind < 0.7:
            move = (float(rng.choice(INFLATIONS)), vent, 1.0)
        elif kind < 0.87:
            move = (0.0, vent, 1.0)
        length = int(rng.integers(6, 31))
        rows[i : i + length, 1:] = move
        i += length
    return Plan("prbs", time_s, rows, Control(False, guard_kPa=GUARD_KPA), _start_kPa(rng))


def bends(rng: Generator, time_s: Array, venturi: bool = True) -> Plan:
    """A vine is bent and released, 0.9 to 2 s each."""
    rows = _rows(time_s)
    half_s = rng.uniform(0.9, 2.0)
    rows[:, 0] = np.where(np.floor(time_s / half_s) % 2 == 0, BEND_KPA, 0.0)
    return Plan("bends", time_s, rows, Control(True, venturi), _start_kPa(rng))


def hold(rng: Generator, time_s: Array, venturi: bool = True) -> Plan:
    """Half open for 0.8 s, then everything shut."""
    rows = _rows(time_s)
    rows[time_s < 0.8 - 1e-9, 1] = 0.5
    return Plan("hold", time_s, rows, Control(False, venturi, HOLD_GUARD_KPA), _start_kPa(rng))


FOUR_RUNS = (steps, prbs, bends, hold)


def discharge(rng: Generator) -> Plan:
    """The reservoir empties through the inflation valve, open from the first sample; 90 s at 10 samples/s."""
    time_s = steady_time(90.0, 0.1)
    rows = _rows(time_s)
    rows[:, 1] = 1.0
    return Plan("discharge", time_s, rows, Control(False), float(rng.uniform(300.0, FULL_KPA)))


def hanging(plan: Plan, from_sample: int, samples: int) -> Plan:
    """The plan with a host that hangs, from the next time at which the inflation valve is shut."""
    return replace(plan, control=plan.control._replace(stall_from=from_sample, stall_samples=samples))
