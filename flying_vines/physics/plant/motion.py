"""How a valve follows its command: delay, backlash, dead zone, lag, in this order; a solenoid's two delays.

The first three belong to one tick of the firmware, during which a command holds; delays are whole ticks. The
lag dx/dt = (target − x) / τ is exact, whatever the step.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, expm1


@dataclass(frozen=True)
class ValveMotion:
    """A proportional valve; as it stands it is where it is told to be.

    `backlash_width` is the full width of the play, a share of full command, closed and reset by a command of
    0;
    `dead_opening` is the command up to which the valve stays shut.
    """

    delay_s: float = 0.0
    backlash_width: float = 0.0
    dead_opening: float = 0.0
    time_constant_s: float = 0.0

    def __post_init__(self) -> None:
        if not (self.delay_s >= 0.0 and self.backlash_width >= 0.0 and self.time_constant_s >= 0.0):
            raise ValueError("a delay, a play and a lag are not negative")
        if not 0.0 <= self.dead_opening < 1.0:
            raise ValueError("a dead zone lies in 0…1")


CLIPPARD_EVP = ValveMotion(delay_s=0.003, backlash_width=0.1, dead_opening=0.3, time_constant_s=0.010)
"""Hysteresis as the maker states it (10 % nominal); dead zone, lag and delay are assumptions."""
CLIPPARD_DVP = ValveMotion(delay_s=0.004, backlash_width=0.1, dead_opening=0.3, time_constant_s=0.020)
"""As the EVP, and slower. Assumption."""


@dataclass(frozen=True)
class SolenoidTiming:
    """A solenoid opens or closes once it has been told so for this long."""

    opening_s: float = 0.0
    closing_s: float = 0.0

    def __post_init__(self) -> None:
        if not (self.opening_s >= 0.0 and self.closing_s >= 0.0):
            raise ValueError("a solenoid's delays are not negative")


HUAMEI_12V = SolenoidTiming(opening_s=0.010, closing_s=0.020)
"""Within what is usual for small solenoids. Assumption."""


def backlash(held: float, command: float, width: float) -> float:
    """What play passes on: the nearest to what it held within width/2 of the command (the play operator)."""
    if command <= 0.0:
        return 0.0
    half = width / 2.0
    return max(command - half, min(command + half, held))


def dead_zone(command: float, dead_opening: float) -> float:
    """max(0, (u − u₀) / (1 − u₀)), at most 1: a full command still opens fully."""
    return min(1.0, max(0.0, (command - dead_opening) / (1.0 - dead_opening)))


def ticks(delay_s: float, tick_s: float) -> int:
    """A delay in whole ticks, the nearest."""
    return round(delay_s / tick_s)


def solenoid_after(
    is_open: bool, waited_ticks: int, told_open: bool, opening_ticks: int, closing_ticks: int
) -> tuple[bool, int]:
    """Whether a solenoid is open during this tick, and for how many ticks it has been told otherwise."""
    if told_open == is_open:
        return is_open, 0
    if waited_ticks >= (opening_ticks if told_open else closing_ticks):
        return told_open, 0
    return is_open, waited_ticks + 1


def opening_after(per_s: float, opening: float, target: float, dt_s: float) -> float:
    """Where a valve with a lag is `dt_s` on; `per_s` is 1/τ, 0 without a lag."""
    if per_s == 0.0:
        return target
    return target + (opening - target) * exp(-dt_s * per_s)


def opening_midway(per_s: float, opening: float, target: float, dt_s: float) -> float:
    """The opening at half a step with which Simpson's rule gives the mean over the step exactly."""
    steps = dt_s * per_s
    if steps < 1e-6:
        return opening_after(per_s, opening, target, 0.5 * dt_s)
    mean = -expm1(-steps) / steps
    return target + (opening - target) * (6.0 * mean - 1.0 - exp(-steps)) / 4.0
