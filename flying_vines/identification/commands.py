"""What the three valves do over time: steps, each holding until the next."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flying_vines.identification.model import Array


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
