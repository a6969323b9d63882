"""Tests a model on data that its fit has not seen.

Each run is predicted from a fit to all other runs. This fit also sees the first 0.5 s of the run and the
first 0.5 s after each gap, to find the initial pressures. These parts are not scored.

Alternate blocks of 2 s are held out instead if there is only one run, or if the other runs do not determine a
parameter (for example, only one run reaches the pressure at which the Venturi stalls).

Every such fit starts from the nominal rig and from the seeds of the causes. Otherwise information from the
held-out data would leak into the fit.

The interval of the gain is from a block bootstrap (Künsch 1989): errors of a simulation are correlated from
sample to sample, but hardly from block to block.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flying_vines.identification.cores import mapped
from flying_vines.identification.fit import Bools, FitPoint, FitProblem
from flying_vines.identification.intervals import LikelihoodProfile
from flying_vines.physics.arrays import Array

SHOWN_S = 0.5
STRETCH_S = 2.0
BLOCK_S = 4.0
FAR = 3.0
"""Distance, in half widths of its interval, at which a parameter is tested."""
MIN_RISE = 4.0
"""A parameter is not determined if χ² rises by less at this distance."""
STEPS = 4
_DRAWS = 1000


@dataclass(frozen=True)
class HeldOut:
    """Root mean square errors on unseen data, relative to the measured range; both channels count equally."""

    nrmse_before: float
    """Error of the null model."""
    nrmse_after: float
    """Error with the chosen causes."""
    noise_floor: float
    """Error from noise alone."""
    gain: tuple[float, float]
    """95 % interval of the relative error reduction by the causes; (0, 0) without causes."""


@dataclass(frozen=True)
class Split:
    """The data that a fit sees, and the data on which it is scored."""

    shown: FitProblem
    scored: tuple[Bools, ...]
    """For each run, (n,)."""
    fitted: FitPoint
    """The chosen causes, fitted to the shown data only."""


@dataclass(frozen=True)
class _Errors:
    """Prediction errors for each block and channel."""

    squares: Array
    """(blocks, 2) sums of squared residuals, in units of noise."""
    count: Array
    """(blocks, 2) readings."""


def held_out(problem: FitProblem, splits: Sequence[Split], null: FitPoint | None) -> HeldOut:
    """Errors of the null model and of the chosen causes, both refitted without the data that they predict.

    Args:
        null: the null model; None if it was itself chosen.
    """
    after = _errors(problem, splits, lambda split: split.fitted)
    before = after
    if null is not None:
        before = _errors(problem, splits, lambda split: _refitted(split.shown, null))
    floor = float(_nrmse(problem, _Errors(before.count, before.count)))
    return HeldOut(
        float(_nrmse(problem, before)), float(_nrmse(problem, after)), floor, _gain(problem, before, after)
    )


def unseen_error(problem: FitProblem, splits: Sequence[Split], point: FitPoint) -> float:
    """A quick estimate of a candidate's error: two iterations from its fit to all data.

    It is only used for the table of candidates that were not chosen.
    """
    return float(_nrmse(problem, _errors(problem, splits, lambda split: split.shown.fit(point, 2).point)))


def splits_for(problem: FitProblem, chosen: FitPoint, profiles: Sequence[LikelihoodProfile]) -> list[Split]:
    """All splits for testing the chosen causes, whose parameters have these profiles."""
    every = mapped(lambda i: _of_run(problem, chosen, profiles, i), range(len(problem.case.runs)))
    return [split for splits in every for split in splits]


def _of_run(
    problem: FitProblem, chosen: FitPoint, profiles: Sequence[LikelihoodProfile], i: int
) -> list[Split]:
    time_s = problem.case.runs[i].time_s - problem.case.runs[i].time_s[0]
    beginning = _beginnings(time_s, problem.simulation.runs[i].start)
    if len(problem.case.runs) > 1:
        others = _split(problem, chosen, i, ~beginning)
        if _fixed(others, profiles):
            return [others]
    odd = (time_s // STRETCH_S) % 2 == 1
    return [_split(problem, chosen, i, unseen & ~beginning) for unseen in (odd, ~odd)]


def _beginnings(time_s: Array, start: NDArray[np.intp]) -> Bools:
    """The first half second after each start; of shorter stretches, the first half."""
    ends = np.append(start[1:], len(time_s)) - 1
    shown_s = np.minimum(SHOWN_S, (time_s[ends] - time_s[start]) / 2.0)
    stretch = np.repeat(np.arange(len(start)), np.diff(np.append(start, len(time_s))))
    beginnings: Bools = time_s - time_s[start[stretch]] <= shown_s[stretch]
    return beginnings


def _split(problem: FitProblem, chosen: FitPoint, i: int, unseen: Bools) -> Split:
    """The split that predicts these samples of a run from all other samples."""
    used = [np.ones(len(run.time_s), dtype=np.bool_) for run in problem.case.runs]
    used[i] = ~unseen
    shown = FitProblem(problem.case, problem.noise_kPa, used)
    return Split(shown, tuple(~mask for mask in used), _refitted(shown, chosen))


def _fixed(split: Split, profiles: Sequence[LikelihoodProfile]) -> bool:
    """True if the shown data alone determine every parameter."""
    shown, point = split.shown, split.fitted
    least = shown.fit(point, 1).cost
    names = [cause.name for cause in point.causes]
    for profile in profiles:
        index = names.index(profile.cause)
        number = point.causes[index].parameters.index(profile.parameter)
        parameter, value = profile.parameter, point.values[index][number]
        for far in (profile.high - profile.estimate, profile.low - profile.estimate):
            moved = float(np.clip(value + FAR * far, parameter.low, parameter.high))
            if moved == value:
                continue
            held = shown.fit(point.pinned(index, number, moved), STEPS)
            if held.cost + parameter.prior_penalty(parameter.to_search(moved)) - least < MIN_RISE:
                return False
    return True


def _errors(problem: FitProblem, splits: Sequence[Split], refit: Callable[[Split], FitPoint]) -> _Errors:
    squares, count = [], []
    predicted = mapped(lambda split: problem.residuals(refit(split)), splits)
    for split, residuals in zip(splits, predicted, strict=True):
        for i, residual in enumerate(residuals):
            time_s = problem.case.runs[i].time_s
            block = ((time_s - time_s[0]) // BLOCK_S).astype(np.intp)
            used = split.scored[i] & (problem.weights[i] > 0.0)
            squares.append(np.stack([np.bincount(block, row) for row in residual**2 * used], 1))
            count.append(np.stack([np.bincount(block, row) for row in used.astype(np.float64)], 1))
    scored = np.concatenate(count, dtype=np.float64)
    kept = scored.any(axis=1)
    return _Errors(np.concatenate(squares, dtype=np.float64)[kept], scored[kept])


def _refitted(problem: FitProblem, point: FitPoint) -> FitPoint:
    """The same causes and free numbers, fitted from their starting values."""
    fit = problem.fit(problem.start().freed(tuple(point.deviation)))
    for cause in point.causes:
        fit = problem.begun(fit.point, cause)
    return problem.fit(fit.point).point


def _gain(problem: FitProblem, before: _Errors, after: _Errors) -> tuple[float, float]:
    if after is before:
        return 0.0, 0.0
    drawn = np.random.default_rng(0).integers(0, len(before.count), (_DRAWS, len(before.count)))
    shares = 1.0 - _nrmse(problem, after, drawn) / _nrmse(problem, before, drawn)
    low, high = np.quantile(shares, (0.025, 0.975))
    return float(low), float(high)


def _nrmse(problem: FitProblem, errors: _Errors, drawn: NDArray[np.intp] | None = None) -> Array:
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
