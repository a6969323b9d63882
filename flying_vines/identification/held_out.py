"""How well a model predicts what its fit never saw.

Each run is predicted from all others. Its first half second, and that after each gap in its record, is shown
to the fit, because where the pressures are then can be known from nothing else; it is not scored. Where the
others do not fix a parameter (only one run comes down to where the Venturi stalls), and where there is only
one run, every other stretch of two seconds is predicted from all the rest. Every such fit starts from what
was believed and from the causes' seeds: a number that the shown data do not fix must not be where the unseen
data have put it.

How sure the gain is follows from drawing blocks of a few seconds again and again (Künsch 1989): errors of a
simulation are alike from sample to sample, but hardly from block to block.
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
"""Half widths of its interval: a parameter that might as well be so far off is not fixed."""
ANYWHERE = 4.0
"""By so little χ²."""
STEPS = 4
_DRAWS = 1000


@dataclass(frozen=True)
class HeldOut:
    """Root mean square errors over the range of what was measured (both channels alike), on unseen data."""

    nrmse_before: float
    """Of the null."""
    nrmse_after: float
    """Of the chosen causes."""
    noise_floor: float
    """Of noise alone."""
    gain: tuple[float, float]
    """95 % interval of the share of the error that the causes take away; (0, 0) where there are none."""


@dataclass(frozen=True)
class Split:
    """What a fit is shown, and what it is scored on."""

    shown: FitProblem
    scored: tuple[Bools, ...]
    """Run by run, (n,)."""
    fitted: FitPoint
    """The chosen causes, fitted from nothing to what is shown."""


@dataclass(frozen=True)
class _Errors:
    """Of what was predicted, block by block and channel by channel."""

    squares: Array
    """(blocks, 2) sums of squared residuals, in units of noise."""
    count: Array
    """(blocks, 2) readings."""


def held_out(problem: FitProblem, splits: Sequence[Split], null: FitPoint | None) -> HeldOut:
    """Errors of the null and of the chosen causes, both refitted without what they predict.

    Args:
        null: the baseline, if it was not chosen itself.
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
    """The error of some causes alone, as in `HeldOut`, but after two steps from where all data have put
    them: for a table of those that were not chosen."""
    return float(_nrmse(problem, _errors(problem, splits, lambda split: split.shown.fit(point, 2).point)))


def splits_for(problem: FitProblem, chosen: FitPoint, profiles: Sequence[LikelihoodProfile]) -> list[Split]:
    """What is predicted from what.

    Args:
        chosen: the causes that are to be judged.
        profiles: of their parameters.
    """
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
    """The first half second from each start on; of shorter stretches, the first half."""
    ends = np.append(start[1:], len(time_s)) - 1
    shown_s = np.minimum(SHOWN_S, (time_s[ends] - time_s[start]) / 2.0)
    stretch = np.repeat(np.arange(len(start)), np.diff(np.append(start, len(time_s))))
    beginnings: Bools = time_s - time_s[start[stretch]] <= shown_s[stretch]
    return beginnings


def _split(problem: FitProblem, chosen: FitPoint, i: int, unseen: Bools) -> Split:
    """These samples of a run, from all the rest."""
    used = [np.ones(len(run.time_s), dtype=np.bool_) for run in problem.case.runs]
    used[i] = ~unseen
    shown = FitProblem(problem.case, problem.noise_kPa, used)
    return Split(shown, tuple(~mask for mask in used), _refitted(shown, chosen))


def _fixed(split: Split, profiles: Sequence[LikelihoodProfile]) -> bool:
    """Whether no parameter can lie far outside its interval, for all that is shown."""
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
            if held.cost + parameter.surprise(parameter.inner(moved)) - least < ANYWHERE:
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
    """The same causes and free numbers, fitted from nothing."""
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
    """Of all blocks; or of each draw of blocks, (draws, blocks)."""
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
