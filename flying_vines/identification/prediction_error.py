"""The error of a model on data that its fit has not seen.

Errors are root mean squares relative to the measured range; both channels count equally. The first 0.5 s of a
run and the first 0.5 s after each gap are shown to every fit, to find the initial pressures; they are not
scored.

A gain is a relative reduction of the error. Its interval is from a block bootstrap (Künsch 1989): errors of a
simulation are correlated from sample to sample, but hardly from block to block.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from flying_vines.identification.fit import FitPoint, FitProblem
from flying_vines.identification.threads import mapped
from flying_vines.physics.arrays import Array, BoolArray

SHOWN_S = 0.5
STRETCHES = 14
"""A run has this many stretches of equal length; every second one is held out. Each half of a run has an odd
number of them. Otherwise all inflations of a cycle that is repeated twice or four times may be held out."""
BLOCK_S = 4.0
MIN_BLOCKS = 25
"""Minimum number of blocks in all runs together: a short recording has shorter blocks. If there were only
ten blocks and the misfit were in two of them, one draw in ten would contain neither."""
BLOCK_SAMPLES = 4
"""Blocks are at least this long, in median sampling intervals."""
STEPS = 2
"""Steps of a fit to the shown data, from the fit to all data."""
_DRAWS = 1000


@dataclass(frozen=True)
class Split:
    """The data that a fit sees, and the data on which it is scored."""

    shown: FitProblem
    scored: tuple[BoolArray, ...]
    """For each run (n,): True for the samples that are scored."""


@dataclass(frozen=True)
class Errors:
    """Prediction errors for each block and channel."""

    squares: Array
    """(blocks, 2) sums of squared residuals, in units of noise."""
    count: Array
    """(blocks, 2) number of readings."""


class HeldOutErrors:
    """Compares candidates during the search: every other stretch of all runs is predicted from the rest.

    The fits start from the fits to all data, and take two steps.
    """

    def __init__(self, problem: FitProblem) -> None:
        self._problem = problem
        self._errors: dict[int, tuple[FitPoint, Errors]] = {}

    @cached_property
    def _splits(self) -> list[Split]:
        odd = [in_odd_stretch(run.time_s) for run in self._problem.case.runs]
        return [split(self._problem, part) for part in (odd, [~mask for mask in odd])]

    def errors(self, point: FitPoint) -> Errors:
        """The errors of a model with these causes and free numbers."""
        known = self._errors.get(id(point))
        if known is None:
            known = self._errors[id(point)] = (point, quick_errors(self._problem, self._splits, point))
        return known[1]

    def gain(self, before: FitPoint, after: FitPoint) -> tuple[float, float]:
        """95 % interval of the relative error reduction from one model to the other."""
        return gain(self._problem, self.errors(before), self.errors(after))


def in_odd_stretch(time_s: Array) -> BoolArray:
    """(n,): every other one of the stretches of a run."""
    since = time_s - time_s[0]
    odd: BoolArray = (since * STRETCHES // (since[-1] * (1.0 + 1e-9))) % 2 == 1
    return odd


def blocks(times_s: Sequence[Array], at_least: int = MIN_BLOCKS) -> list[NDArray[np.intp]]:
    """For each run (n,) the block numbers of its samples.

    All runs together have `at_least` blocks or more, if the readings are dense enough.
    """
    longest_s = min(BLOCK_S, sum(float(time_s[-1] - time_s[0]) for time_s in times_s) / at_least)
    found = []
    for time_s in times_s:
        length_s = max(longest_s, BLOCK_SAMPLES * float(np.median(np.diff(time_s))))
        found.append(((time_s - time_s[0]) // length_s).astype(np.intp))
    return found


def split(problem: FitProblem, unseen: Sequence[BoolArray]) -> Split:
    """The split that predicts these samples, (n,) for each run, from all others and from the beginnings."""
    scored = tuple(
        mask & ~_beginnings(run.time_s, prepared.start)
        for mask, run, prepared in zip(unseen, problem.case.runs, problem.simulation.runs, strict=True)
    )
    return Split(FitProblem(problem.case, problem.noise, [~mask for mask in scored]), scored)


def _beginnings(time_s: Array, start: NDArray[np.intp]) -> BoolArray:
    """The first half second after each start; of shorter stretches, the first half."""
    ends = np.append(start[1:], len(time_s)) - 1
    shown_s = np.minimum(SHOWN_S, (time_s[ends] - time_s[start]) / 2.0)
    stretch = np.repeat(np.arange(len(start)), np.diff(np.append(start, len(time_s))))
    beginnings: BoolArray = time_s - time_s[start[stretch]] <= shown_s[stretch]
    return beginnings


def quick_errors(problem: FitProblem, splits: Sequence[Split], point: FitPoint) -> Errors:
    """The errors of predictions by quick fits to the shown data of each split: `STEPS` steps from `point`."""
    return errors(problem, splits, mapped(lambda split: split.shown.fit(point, STEPS).point, splits))


def errors(problem: FitProblem, splits: Sequence[Split], fitted: Sequence[FitPoint]) -> Errors:
    """The errors of predictions, from a model fitted to the shown data of each split."""
    squares, count = [], []
    predicted = mapped(problem.residuals, fitted)
    blocks_of = blocks([run.time_s for run in problem.case.runs])
    for part, residuals in zip(splits, predicted, strict=True):
        for i, residual in enumerate(residuals):
            block = blocks_of[i]
            used = part.scored[i] & (problem.weights[i] > 0.0)
            squares.append(np.stack([np.bincount(block, row) for row in residual**2 * used], 1))
            count.append(np.stack([np.bincount(block, row) for row in used.astype(np.float64)], 1))
    scored = np.concatenate(count, dtype=np.float64)
    kept = scored.any(axis=1)
    return Errors(np.concatenate(squares, dtype=np.float64)[kept], scored[kept])


def gain(problem: FitProblem, before: Errors, after: Errors) -> tuple[float, float]:
    """95 % interval of the relative error reduction; (0, 0) if both are the same."""
    if after is before:
        return 0.0, 0.0
    drawn = np.random.default_rng(0).integers(0, len(before.count), (_DRAWS, len(before.count)))
    shares = 1.0 - nrmse(problem, after, drawn) / nrmse(problem, before, drawn)
    low, high = np.quantile(shares, (0.025, 0.975))
    return float(low), float(high)


def nrmse(problem: FitProblem, errors: Errors, drawn: NDArray[np.intp] | None = None) -> Array:
    """The error over all blocks; or for each draw, if `drawn` (draws, blocks) is given."""
    squares, count = (
        values.sum(axis=0) if drawn is None else values[drawn].sum(axis=1)
        for values in (errors.squares, errors.count)
    )
    shares = []
    for row, noise_kPa in enumerate(problem.noise_kPa):
        measured = [
            data[row][weight[row] > 0.0] for data, weight in zip(problem.data, problem.weights, strict=True)
        ]
        values = np.concatenate(measured)
        if not len(values) or np.ptp(values) == 0.0:
            continue
        mean = squares[..., row] / np.maximum(1.0, count[..., row])
        shares.append(mean * (noise_kPa / float(np.ptp(values))) ** 2)
    error: Array = np.sqrt(np.mean(shares, axis=0))
    return error
