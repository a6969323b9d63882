"""What the three valves are told over time, and what they do: steps, each holding until the next."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flying_vines.physics.arrays import Array
from flying_vines.physics.compiler import compiled
from flying_vines.physics.plant.motion import SolenoidTiming, ValveMotion, backlash, dead_zone


class Steps(NamedTuple):
    """One valve: `value[i]` holds from `time_s[i]` until the next; the first holds from before the run."""

    time_s: Array
    value: Array


class Commands(NamedTuple):
    """The three valves: openings 0…1, and the solenoid, 0 or 1."""

    evp: Steps
    dvp: Steps
    solenoid: Steps


def steps_of(time_s: Array, value: Array) -> Steps:
    """The steps of a sampled command: only where it changes."""
    changes = np.flatnonzero(np.diff(value)) + 1
    kept = np.concatenate(([0], changes))
    return Steps(time_s[kept], value[kept])


def together(commands: Commands) -> tuple[Array, Array]:
    """All switchings in one: times (m,), and what the three valves do from each on, (m, 3)."""
    times = np.unique(np.concatenate([steps.time_s for steps in commands]))
    openings = np.empty((len(times), 3))
    for column, (time_s, value) in enumerate(commands):
        # Before its first step a valve does what that says.
        openings[:, column] = value[np.maximum(0, np.searchsorted(time_s, times, side="right") - 1)]
    return times, openings


def followed(
    told: Commands, evp: ValveMotion | None, dvp: ValveMotion | None, solenoid: SolenoidTiming | None
) -> Commands:
    """What the valves do of what they are told, at exact times: delays, backlash, dead zones. Lags are for
    the integrator."""
    return Commands(
        _moved(told.evp, evp) if evp else told.evp,
        _moved(told.dvp, dvp) if dvp else told.dvp,
        _turned(told.solenoid, solenoid) if solenoid else told.solenoid,
    )


def _moved(told: Steps, motion: ValveMotion) -> Steps:
    time_s, value = told
    if motion.delay_s > 0.0:
        # From rest: until the first command arrives the valve is shut.
        time_s = np.concatenate((time_s[:1], time_s + motion.delay_s))
        value = np.concatenate(([0.0], value))
    if motion.backlash_width > 0.0 or motion.dead_opening > 0.0:
        value = compiled(moved_openings)(value, motion.backlash_width, motion.dead_opening)
    return Steps(time_s, value)


def moved_openings(told: Array, backlash_width: float, dead_opening: float) -> Array:
    """Where a valve with play and a dead zone goes, from shut."""
    moved = np.empty(len(told))
    held = 0.0
    for i in range(len(told)):
        held = backlash(held, told[i], backlash_width)
        moved[i] = dead_zone(held, dead_opening)
    return moved


def _turned(told: Steps, timing: SolenoidTiming) -> Steps:
    opens = told.value > 0.0
    turns = np.concatenate(([False], opens[1:] != opens[:-1]))
    time_s = told.time_s + np.where(turns, np.where(opens, timing.opening_s, timing.closing_s), 0.0)
    # Told otherwise again before it has turned, it stays as it is.
    again = np.concatenate((told.time_s[1:], [np.inf]))
    kept = ~(turns & (time_s > told.time_s) & (time_s >= again))
    return Steps(time_s[kept], told.value[kept])
