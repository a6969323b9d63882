"""Tests a model on data that its fit has not seen.

Each run is predicted from a fit to all other runs. If there is only one run, or the other runs do not
determine a parameter (for example, only one run reaches the pressure at which the Venturi stalls), alternate
stretches of the run are held out instead.

Every such fit starts from the nominal rig and from seeds of the causes. Otherwise information from the
held-out data would leak into the fit. A second fit starts from the fit to all data. It is only used if the
first fit has ended in a local minimum, far above that of the second fit. During a search, candidates are
compared by quick fits to every other stretch of all runs.

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
from flying_vines.identification.intervals import LikelihoodProfile, blocks
from flying_vines.identification.jacobian import Jacobian
from flying_vines.identification.simulate import mapped
from flying_vines.physics.arrays import Array, BoolArray

SHOWN_S = 0.5
STRETCHES = 14
"""A run has this many stretches of equal length; every second one is held out. Each half of a run has an odd
number of them. Otherwise all inflations of a cycle that is repeated twice or four times may be held out."""
STEPS = 2
"""Steps of a fit to the shown data, from the fit to all data."""
_DRAWS = 1000
FAR = 3.0
"""A parameter is tested at this distance from its estimate, in half widths of its interval."""
MIN_RISE = 4.0
"""A parameter is not determined if χ² rises by less than this at the distance `FAR`."""
PINNED_STEPS = 4
LOCAL_MINIMUM = 25.0
"""The first fit is in a local minimum if its cost is higher than that of the second by more than this."""


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

    @property
    def explained(self) -> float:
        """Share of the squared error above noise that the causes remove."""
        over_noise = self.nrmse_before**2 - self.noise_floor**2
        removed = self.nrmse_before**2 - self.nrmse_after**2
        return removed / over_noise if over_noise > 0.0 else 0.0


@dataclass(frozen=True)
class Prediction:
    """A split, and the chosen causes fitted to its shown data only."""

    split: Split
    fitted: FitPoint


def held_out(problem: FitProblem, predictions: Sequence[Prediction], null: FitPoint | None) -> HeldOut:
    """Errors of the null model and of the chosen causes, both refitted without the data that they predict.

    Args:
        null: the null model; None if it was itself chosen.
    """
    splits = [prediction.split for prediction in predictions]
    after = before = errors(problem, splits, [prediction.fitted for prediction in predictions])
    if null is not None:
        jacobian = problem.jacobian(problem.at(null))
        before = errors(problem, splits, mapped(lambda s: _refitted(s.shown, null, jacobian), splits))
    noise = [sensor.variance_over_slow for sensor in problem.noise]
    floor = nrmse(problem, Errors(before.count * noise, before.count))
    return HeldOut(
        float(nrmse(problem, before)),
        float(nrmse(problem, after)),
        float(floor),
        gain(problem, before, after),
    )


def unseen_error(problem: FitProblem, predictions: Sequence[Prediction], point: FitPoint) -> float:
    """A quick estimate of a candidate's error: two steps from its fit to all data.

    It is only used in the table of candidates, for those that were not chosen.
    """
    splits = [prediction.split for prediction in predictions]
    return float(nrmse(problem, quick_errors(problem, splits, point)))


def predictions_for(
    problem: FitProblem, chosen: FitPoint, jacobian: Jacobian, profiles: Sequence[LikelihoodProfile]
) -> list[Prediction]:
    """Predictions of all data by the chosen causes.

    Args:
        chosen: the fit to all data, with its `jacobian` and the likelihood profiles of its parameters.
    """
    every = mapped(lambda i: _of_run(problem, chosen, jacobian, profiles, i), range(len(problem.case.runs)))
    return [prediction for predictions in every for prediction in predictions]


def _of_run(
    problem: FitProblem, chosen: FitPoint, jacobian: Jacobian, profiles: Sequence[LikelihoodProfile], i: int
) -> list[Prediction]:
    nothing = [np.zeros(len(run.time_s), dtype=np.bool_) for run in problem.case.runs]

    def predicted(unseen: BoolArray) -> Prediction:
        part = split(problem, [*nothing[:i], unseen, *nothing[i + 1 :]])
        return Prediction(part, _refitted(part.shown, chosen, jacobian))

    if len(problem.case.runs) > 1:
        others = predicted(~nothing[i])
        if _fixed(others, profiles):
            return [others]
    odd = in_odd_stretch(problem.case.runs[i].time_s)
    return [predicted(odd), predicted(~odd)]


def _fixed(prediction: Prediction, profiles: Sequence[LikelihoodProfile]) -> bool:
    """True if the shown data alone determine every parameter."""
    shown, point = prediction.split.shown, prediction.fitted
    here = shown.at(point)
    jacobian, least = shown.jacobian(here), here.cost
    names = [cause.name for cause in point.causes]
    for profile in profiles:
        index = names.index(profile.cause)
        number = point.causes[index].parameters.index(profile.parameter)
        parameter, value = profile.parameter, point.values[index][number]
        for far in (profile.high - profile.estimate, profile.low - profile.estimate):
            moved = float(np.clip(value + FAR * far, parameter.low, parameter.high))
            if moved == value:
                continue
            held = shown.fit(point.pinned(index, number, moved), PINNED_STEPS, known=jacobian)
            if held.cost + parameter.prior_penalty(parameter.to_search(moved)) - least < MIN_RISE:
                return False
    return True


def _refitted(problem: FitProblem, point: FitPoint, jacobian: Jacobian) -> FitPoint:
    """The same causes and free numbers, fitted from their starting values.

    Args:
        jacobian: derivatives at `point`, of all data.
    """
    start = problem.start().with_free(tuple(point.deviation))
    for cause, values in zip(point.causes, point.values, strict=True):
        start = start.with_cause(cause, cause.nearest_seed(values))
    fit, near = problem.fit(start), problem.fit(point, known=jacobian.where(problem.used))
    return near.point if near.cost < fit.cost - LOCAL_MINIMUM else fit.point
