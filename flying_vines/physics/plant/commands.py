"""Commands and openings of the three valves over time, as steps that hold until the next one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flying_vines.physics.arrays import Array
from flying_vines.physics.compiler import compiled
from flying_vines.physics.plant.valve_response import SolenoidTiming, ValveMotion, backlash, dead_zone

HEATED_PART = 0.02
"""The opening that a warming valve loses is computed once for this share of its heating time constant. The
error is 1e-4 of the loss."""


class Steps(NamedTuple):
    """Steps of one valve: `value[i]` holds from `time_s[i]` until the next; `value[0]` also holds before."""

    time_s: Array
    value: Array


class Commands(NamedTuple):
    """Steps of the three valves: openings 0…1, and the solenoid, 0 or 1."""

    evp: Steps
    dvp: Steps
    solenoid: Steps


def steps_of(time_s: Array, value: Array) -> Steps:
    """The steps of a sampled command."""
    changes = np.flatnonzero(np.diff(value)) + 1
    kept = np.concatenate(([0], changes))
    return Steps(time_s[kept], value[kept])


def together(commands: Commands) -> tuple[Array, Array]:
    """All steps merged: times (m,), and the openings of the three valves from each time on, (m, 3)."""
    times = np.unique(np.concatenate([steps.time_s for steps in commands]))
    openings = np.empty((len(times), 3))
    for column, (time_s, value) in enumerate(commands):
        # The first value of a valve also holds before its time.
        openings[:, column] = value[np.maximum(0, np.searchsorted(time_s, times, side="right") - 1)]
    return times, openings


def followed(
    commands: Commands,
    evp: ValveMotion | None,
    dvp: ValveMotion | None,
    solenoid: SolenoidTiming | None,
    until_s: float,
) -> Commands:
    """The openings up to `until_s`: the commands after delays, backlash, dead zones and heating.

    Their times are not rounded to ticks. The integrator adds the lags.
    """
    return Commands(
        _moved(commands.evp, evp, until_s) if evp else commands.evp,
        _moved(commands.dvp, dvp, until_s) if dvp else commands.dvp,
        _switched(commands.solenoid, solenoid) if solenoid else commands.solenoid,
    )


def _moved(commands: Steps, motion: ValveMotion, until_s: float) -> Steps:
    time_s, value = commands
    if motion.delay_s > 0.0:
        # The valve is shut until the first command arrives.
        time_s = np.concatenate((time_s[:1], time_s + motion.delay_s))
        value = np.concatenate(([0.0], value))
    driven = value
    if motion.backlash_width > 0.0 or motion.dead_opening > 0.0:
        value = compiled(moved_openings)(value, motion.backlash_width, motion.dead_opening)
    if motion.heating_share > 0.0:
        return _heated(time_s, driven, value, motion, until_s)
    return Steps(time_s, value)


def _heated(time_s: Array, driven: Array, value: Array, motion: ValveMotion, until_s: float) -> Steps:
    """Openings of a valve whose coil warms up; `driven` are its commands, before backlash and dead zone.

    The last opening holds until `until_s`. The loss is computed for parts that are short against the
    heating's time constant.
    """
    lasts_s = np.diff(time_s, append=max(until_s, time_s[-1]))
    counts = np.where(value > 0.0, np.ceil(lasts_s / (HEATED_PART * motion.heating_time_s)), 1.0)
    counts = np.maximum(counts, 1.0).astype(int)
    warmth, every = np.empty(len(value)), np.repeat(np.arange(len(value)), counts)
    left = np.exp(-lasts_s / motion.heating_time_s)
    warm = 0.0
    for i in range(len(value)):
        warmth[i] = warm
        warm = driven[i] + (warm - driven[i]) * left[i]
    part_s = (lasts_s / counts)[every]
    since_s = (np.arange(len(every)) - np.repeat(np.cumsum(counts) - counts, counts)) * part_s
    middle = np.exp(-(since_s + 0.5 * part_s) / motion.heating_time_s)
    loss = motion.heating_share * (driven[every] + (warmth[every] - driven[every]) * middle)
    return Steps(time_s[every] + since_s, value[every] * (1.0 - loss))


def moved_openings(commands: Array, backlash_width: float, dead_opening: float) -> Array:
    """Openings of a valve that has backlash and a dead zone, and is shut at first."""
    moved = np.empty(len(commands))
    held = 0.0
    for i in range(len(commands)):
        held = backlash(held, commands[i], backlash_width)
        moved[i] = dead_zone(held, dead_opening)
    return moved


def _switched(commands: Steps, timing: SolenoidTiming) -> Steps:
    opens = commands.value > 0.0
    turns = np.concatenate(([False], opens[1:] != opens[:-1]))
    time_s = commands.time_s + np.where(turns, np.where(opens, timing.opening_s, timing.closing_s), 0.0)
    # A command that is revoked before the solenoid has switched has no effect.
    again = np.concatenate((commands.time_s[1:], [np.inf]))
    valid = ~(turns & (time_s > commands.time_s) & (time_s >= again))
    return Steps(time_s[valid], commands.value[valid])
