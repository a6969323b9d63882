"""The residuals' derivatives, with the initial pressures eliminated.

An initial pressure matters from its start to the next one only, and almost linearly. So stretch by stretch
what the two initial pressures can do is taken out of the derivatives by all other numbers, and of what is
left of the data (Golub & Pereyra 2003, variable projection): a fit may have hundreds of starts and is still
a small problem.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from flying_vines.physics.arrays import Array

_RIDGE = 1e-12


class RunSlopes:
    """Of one run.

    Args:
        initial: (2, 2, n), by the initial pressures (reservoir, control volume), of both channels: of all
            starts at once, for each acts on its own stretch only.
        residuals: (2, n).
        common: (numbers, 2, n), by what is common to the runs.
        start: (starts,) rising, the samples at which stretches begin; the first is 0.
    """

    def __init__(self, initial: Array, residuals: Array, common: Array, start: NDArray[np.intp]) -> None:
        ends = np.append(start[1:], residuals.shape[1])
        self._stretches = [slice(b, e) for b, e in zip(start.tolist(), ends.tolist(), strict=True)]
        self._inverses = [_inverse(initial[:, :, stretch].reshape(2, -1)) for stretch in self._stretches]
        self._initial = initial
        self._common = common
        self._residuals = residuals

    def _shares(self, columns: Array) -> list[Array]:
        """Of each stretch (columns, 2): which change of its two pressures comes nearest to each column."""
        return [
            columns[:, :, stretch].reshape(len(columns), -1) @ inverse
            for stretch, inverse in zip(self._stretches, self._inverses, strict=True)
        ]

    def beside(self, columns: Array) -> Array:
        """(columns, 2 n): what is left of (columns, 2, n) beside what the initial pressures can do."""
        left = columns.copy()
        for stretch, shares in zip(self._stretches, self._shares(columns), strict=True):
            left[:, :, stretch] -= np.tensordot(shares, self._initial[:, :, stretch], 1)
        return left.reshape(len(columns), -1)

    @cached_property
    def free(self) -> Array:
        """(numbers, 2 n)"""
        if not len(self._common):
            return np.zeros((0, self._residuals.size))
        return self.beside(self._common)

    @cached_property
    def left(self) -> Array:
        """(2 n,) of the residuals."""
        left: Array = self.beside(self._residuals[None])[0]
        return left

    def initial_move(self, move: Array) -> Array:
        """(starts, 2): how the initial pressures are best moved when the common numbers move so."""
        there = self._residuals + np.tensordot(move, self._common, 1) if len(move) else self._residuals
        return -np.concatenate(self._shares(there[None]))


def _inverse(initial: Array) -> Array:
    """(readings, 2), the pseudo-inverse of (2, readings); a pressure without a reading stays where it is."""
    square = initial @ initial.T
    scale = np.sqrt(np.diag(square))
    scale = np.where(scale > 0.0, scale, 1.0)
    square = square / np.outer(scale, scale) + _RIDGE * np.eye(2)
    square[np.diag_indices(2)] += np.diag(square) < 0.5
    inverse: Array = np.linalg.solve(square, initial / scale[:, None]).T / scale
    return inverse


class Slopes:
    """Of all runs."""

    def __init__(self, runs: Sequence[RunSlopes]) -> None:
        self.runs = runs
        self.free = np.concatenate([run.free for run in runs], axis=1)
        """(numbers, readings)"""
        self.left = np.concatenate([run.left for run in runs])
        """(readings,)"""

    def initial_move(self, move: Array) -> Array:
        """As of a run, in the order of `Point.initial`, in one row."""
        return np.concatenate([run.initial_move(move).ravel() for run in self.runs])

    def beside(self, trace: Sequence[Array]) -> Array:
        """What is left of a trace, (2, n) a run, beside what the initial pressures can do; in one row."""
        return np.concatenate([run.beside(t[None])[0] for run, t in zip(self.runs, trace, strict=True)])
