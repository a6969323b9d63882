"""Tests a model on data that its fit has not seen.

Each run is predicted from a fit to all other runs. If there is only one run, or the other runs do not
determine a parameter (for example, only one run reaches the pressure at which the Venturi stalls), alternate
stretches of the run are held out instead.

Every such fit starts from the nominal rig and from seeds of the causes. Otherwise information from the
held-out data would leak into the fit. A second fit starts from the fit to all data. It is only used if the
first fit has ended in a local minimum, far above that of the second fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flying_vines.identification.fit import FitPoint, FitProblem
from flying_vines.identification.intervals import LikelihoodProfile
from flying_vines.identification.jacobian import Jacobian
from flying_vines.identification.prediction_error import (
    Errors,
    Split,
    errors,
    gain,
    in_odd_stretch,
    nrmse,
    quick_errors,
    split,
)
from flying_vines.identification.threads import mapped
from flying_vines.physics.arrays import BoolArray

FAR = 3.0
"""A parameter is tested at this distance from its estimate, in half widths of its interval."""
MIN_RISE = 4.0
"""A parameter is not determined if χ² rises by less than this at the distance `FAR`."""
PINNED_STEPS = 4
LOCAL_MINIMUM = 25.0
"""The first fit is in a local minimum if its cost is higher than that of the second by more than this."""


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
    start = problem.start().freed(tuple(point.deviation))
    for cause, values in zip(point.causes, point.values, strict=True):
        start = start.with_cause(cause, cause.nearest_seed(values))
    fit, near = problem.fit(start), problem.fit(point, known=jacobian.where(problem.used))
    return near.point if near.cost < fit.cost - LOCAL_MINIMUM else fit.point
