"""The interface of a board."""

from __future__ import annotations

from typing import Protocol

from firmware_link.protocol import Fault, Mode
from flying_vines.physics.baseline import Inputs


class Board(Protocol):
    """A board with firmware. Call `step` at 1 kHz; the other methods at any time."""

    @property
    def mode(self) -> Mode: ...

    @property
    def faults(self) -> Fault: ...

    @property
    def number(self) -> int: ...

    def receive(self, data: bytes) -> None: ...

    def take_output(self) -> bytes: ...

    def step(self, now_us: int, cv_kPa: float, reservoir_kPa: float) -> Inputs: ...

    def reset(self, *, watchdog: bool = False) -> None: ...
