"""A board whose traffic a test observes or changes."""

from __future__ import annotations

from firmware_link.protocol import Fault, Mode
from flying_vines.physics.baseline import Inputs
from flying_vines.simulation.phlosar.firmware import Board


class WrappedBoard:
    """A wrapper that forwards everything to a board. Subclasses observe or change a part of it."""

    def __init__(self, board: Board) -> None:
        self._board = board

    def receive(self, data: bytes) -> None:
        self._board.receive(data)

    def take_output(self) -> bytes:
        return self._board.take_output()

    def step(self, now_us: int, cv_kPa: float, reservoir_kPa: float) -> Inputs:
        return self._board.step(now_us, cv_kPa, reservoir_kPa)

    def reset(self, *, watchdog: bool = False) -> None:
        self._board.reset(watchdog=watchdog)

    @property
    def mode(self) -> Mode:
        return self._board.mode

    @property
    def faults(self) -> Fault:
        return self._board.faults

    @property
    def number(self) -> int:
        return self._board.number
