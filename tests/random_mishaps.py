"""Random mishaps of a simulated phloSAR."""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import NamedTuple

from flying_vines.simulation.phlosar.mishaps import (
    Drifting,
    Filled,
    Gain,
    Glitching,
    Hanging,
    Heated,
    Hole,
    HoseOff,
    Kinked,
    MishapKind,
    Noisy,
    Open,
    Reset,
    Shorted,
    Stuck,
    StuckAt,
    Unpowered,
    WatchdogReset,
)

Momentary = Filled | Heated | Reset | WatchdogReset
"""Mishaps without duration."""


class Mishap(NamedTuple):
    """A mishap; with `ends_s` None it does not end."""

    place: str
    kind: MishapKind
    begins_s: float
    ends_s: float | None


DRAWN: tuple[tuple[str, Callable[[Random], MishapKind]], ...] = (
    ("cv_sensor", lambda _: Stuck()),
    ("cv_sensor", lambda r: Drifting(_either_sign(r, 0.2, 20.0))),
    ("cv_sensor", lambda _: Open()),
    ("cv_sensor", lambda _: Shorted()),
    ("cv_sensor", lambda r: Noisy(_log_uniform(r, 0.5, 10.0))),
    ("cv_sensor", lambda r: Gain(r.choice([0.0, r.uniform(0.5, 1.5)]))),
    ("cv_sensor", lambda r: Glitching(r.uniform(-20.0, 200.0), _log_uniform(r, 5.0, 5000.0))),
    ("reservoir_sensor", lambda _: Stuck()),
    ("reservoir_sensor", lambda r: Drifting(_either_sign(r, 2.0, 200.0))),
    ("reservoir_sensor", lambda _: Open()),
    ("reservoir_sensor", lambda _: Shorted()),
    ("reservoir_sensor", lambda r: Noisy(_log_uniform(r, 3.0, 50.0))),
    ("reservoir_sensor", lambda r: Gain(r.choice([0.0, r.uniform(0.5, 1.5)]))),
    ("reservoir_sensor", lambda r: Glitching(r.uniform(-150.0, 1500.0), _log_uniform(r, 5.0, 5000.0))),
    ("evp", lambda _: StuckAt(1.0)),
    ("evp", lambda _: StuckAt(0.0)),
    ("evp", lambda r: StuckAt(r.uniform(0.02, 0.5))),
    ("dvp", lambda _: StuckAt(1.0)),
    ("dvp", lambda _: StuckAt(0.0)),
    ("solenoid", lambda _: StuckAt(1.0)),
    ("solenoid", lambda _: StuckAt(0.0)),
    ("hose", lambda _: HoseOff()),
    ("hose", lambda _: Kinked()),
    ("hose", lambda r: Kinked(_log_uniform(r, 50.0, 5000.0))),
    ("actuator", lambda r: Hole(r.uniform(2.0, 8.0))),
    ("actuator", lambda r: Hole(_log_uniform(r, 0.05, 0.5))),
    ("reservoir", lambda r: Hole(_log_uniform(r, 0.1, 5.0))),
    ("reservoir", lambda _: Filled(0.0)),
    ("reservoir", lambda r: Filled(r.uniform(765.0, 900.0))),
    ("reservoir", lambda r: Heated(r.uniform(10.0, 60.0))),
    ("board", lambda _: Unpowered()),
    ("board", lambda _: Hanging()),
    ("board", lambda _: Reset()),
    ("board", lambda _: WatchdogReset()),
)
"""The mishaps that `draw_mishap` draws from, with equal probability."""


def draw_mishap(random: Random, within_s: float) -> Mishap:
    """A random mishap that begins within `within_s`. Half of the mishaps with a duration also end within
    it."""
    place, make = random.choice(DRAWN)
    kind = make(random)
    begins_s = random.uniform(0.0, within_s)
    ends = random.random() < 0.5 and not isinstance(kind, Momentary)
    return Mishap(place, kind, begins_s, random.uniform(begins_s, within_s) if ends else None)


def _log_uniform(random: Random, low: float, high: float) -> float:
    return float(low * (high / low) ** random.random())


def _either_sign(random: Random, low: float, high: float) -> float:
    return random.choice([-1.0, 1.0]) * _log_uniform(random, low, high)
