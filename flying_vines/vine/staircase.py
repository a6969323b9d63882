"""A calibration: up and down a staircase of pressures, and what was read is held against what was asked.

Angles are measured by eye or camera (`flying-vines vine fit`); this is what the rig can tell of itself: its
sensor's zero, how well each pressure is held, and what one time up and down takes from the bottle.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

from flying_vines.vine.profile import HoldFor, Segment, Step

SETTLING = 0.5
"""The part of each hold that is waited before readings count."""


def staircase(top_kPa: float, steps: int, hold_s: float) -> Iterator[Segment]:
    """From 0 to `top_kPa` (gauge) in equal steps and down again, each level held; it ends at 0."""
    upwards = [top_kPa * step / steps for step in range(steps + 1)]
    for level_kPa in (*upwards, *reversed(upwards[:-1])):
        yield Step(to_kPa=level_kPa)
        yield HoldFor(for_s=hold_s)


@dataclass
class Level:
    """One pressure that was held, gauge: what was asked, and the mean of what was read."""

    asked_kPa: float
    since: float
    readings: int = 0
    read_kPa: float = 0.0

    @property
    def off_kPa(self) -> float:
        return self.read_kPa - self.asked_kPa

    def take(self, cv_kPa: float) -> None:
        self.readings += 1
        self.read_kPa += (cv_kPa - self.read_kPa) / self.readings


@dataclass
class Readings:
    """What was read on the way; `take` it all, in order of time."""

    hold_s: float
    levels: list[Level] = field(default_factory=list)
    first_reservoir_kPa: float = math.nan
    last_reservoir_kPa: float = math.nan

    def take(self, t: float, asked_kPa: float, cv_kPa: float, reservoir_kPa: float) -> None:
        """A reading of both sensors (gauge) at time `t`, while `asked_kPa` was the setpoint."""
        if not self.levels:
            self.first_reservoir_kPa = reservoir_kPa
        self.last_reservoir_kPa = reservoir_kPa
        if not self.levels or self.levels[-1].asked_kPa != asked_kPa:
            if self.levels and not self.levels[-1].readings:
                self.levels.pop()  # only passed on the way
            self.levels.append(Level(asked_kPa, t))
        level = self.levels[-1]
        if t - level.since >= SETTLING * self.hold_s:
            level.take(cv_kPa)

    @property
    def held(self) -> list[Level]:
        """The levels that were held long enough to be read."""
        return [level for level in self.levels if level.readings]

    def summary(self) -> str:
        """The findings in one sentence."""
        held = self.held
        if not held:
            return "nothing was held long enough to be read"
        worst = max(held[1:] or held, key=lambda level: abs(level.off_kPa))
        took_kPa = self.first_reservoir_kPa - self.last_reservoir_kPa
        return (
            f"zero {held[0].off_kPa:+.2f} kPa, at most {abs(worst.off_kPa):.2f} kPa off "
            f"(at {worst.asked_kPa:.1f}), took {took_kPa:.0f} kPa of the bottle"
        )
