"""A switch on an RC channel. Only observed moves count."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from flying_vines.config.config import SwitchConfig

BOUNDARIES_US = {
    2: (1500.0,),
    3: (1300.0, 1700.0),
    6: (1230.5, 1360.5, 1490.5, 1620.5, 1749.5),
}
"""Boundaries between positions. Those for six positions are from ArduPilot's flight mode channel."""

SAMPLING_SLACK_S = 0.01
"""Allowance for jitter: a debounce time of three sample periods must not wait for a fourth sample."""


@dataclass(frozen=True, slots=True)
class SwitchMove:
    """The switch came to rest in another position, counted from 0 at the lowest pulse width."""

    position: int
    before: int
    jumped: bool = False
    """Several other channels jumped with it, as in a receiver's preset."""


@dataclass(frozen=True, slots=True)
class MovedUnseen:
    """After a loss the switch is in another position. The move was not observed, so it does not count."""

    position: int
    before: int


@dataclass(frozen=True, slots=True)
class SwitchReady:
    """The switch has settled: its next move counts."""

    position: int


class SwitchReader:
    """Debounce and hysteresis. After a loss the switch acts only after a new move.

    Call `sample` with the pulse width while the radio link is good, and `lose` when it is lost. After the
    start and after each loss the pulse width must stay in one position for `settle_s` before moves count.
    """

    def __init__(self, positions: int, debounce_s: float, settle_s: float, hysteresis_us: float) -> None:
        self._boundaries = BOUNDARIES_US[positions]
        self._debounce_s = debounce_s - SAMPLING_SLACK_S
        self._settle_s = settle_s - SAMPLING_SLACK_S
        self._hysteresis_us = hysteresis_us
        self._candidate: int | None = None
        self._candidate_since = 0.0
        self._candidate_jumped = False
        self._before_loss: int | None = None
        self.position: int | None = None

    @classmethod
    def of(cls, switch: SwitchConfig) -> Self:
        return cls(len(switch.positions), switch.debounce_s, switch.settle_s, switch.hysteresis_us)

    @property
    def last_position(self) -> int | None:
        """The position; during a loss, the position before the loss."""
        return self._before_loss if self.position is None else self.position

    def lose(self) -> None:
        if self.position is not None:
            self._before_loss = self.position
        self.position = None
        self._candidate = None

    def sample(
        self, t: float, pulse_us: float, jumped: bool = False
    ) -> SwitchMove | MovedUnseen | SwitchReady | None:
        """Take in the pulse width at `t`; `jumped`: several other channels jumped with it."""
        seen = self.reads(pulse_us)
        if seen != self._candidate:
            self._candidate, self._candidate_since, self._candidate_jumped = seen, t, jumped
        steady_s = t - self._candidate_since
        if self.position is None:
            return self._settle(seen) if steady_s >= self._settle_s else None
        if seen == self.position or steady_s < self._debounce_s:
            return None
        before, self.position = self.position, seen
        return SwitchMove(seen, before, self._candidate_jumped)

    def _settle(self, seen: int) -> MovedUnseen | SwitchReady:
        before, self._before_loss = self._before_loss, None
        self.position = seen
        if before is not None and before != seen:
            return MovedUnseen(seen, before)
        return SwitchReady(seen)

    def reads(self, pulse_us: float) -> int:
        """The position of a pulse width, not debounced. The present position's range includes the hysteresis.

        The settled position is checked first, so a glitch does not move a switch that rests near a boundary.
        """
        for here in (self.position, self._candidate):
            if here is None:
                continue
            low = self._boundaries[here - 1] if here > 0 else float("-inf")
            high = self._boundaries[here] if here < len(self._boundaries) else float("inf")
            if low - self._hysteresis_us <= pulse_us <= high + self._hysteresis_us:
                return here
        return sum(pulse_us >= boundary for boundary in self._boundaries)
