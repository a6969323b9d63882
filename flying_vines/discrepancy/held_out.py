"""How well a model predicts what its fit never saw.

With several runs each is predicted from all others; with one, each half from the other half. Where the
predicted stretch begins a run, its first half second is shown to the fit, because a run's initial pressures
can be known from nothing else; it is not scored.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from flying_vines.discrepancy.fit import Bools, Point, Problem
from flying_vines.discrepancy.model import Array

SHOWN_S = 0.5


@dataclass(frozen=True)
class HeldOut:
    """Root mean square errors over the range of what was measured (both channels alike), on unseen data."""

    nrmse_before: float
    """Of the null."""
    nrmse_after: float
    """Of the chosen causes."""
    noise_floor: float
    """Of noise alone."""


def held_out(problem: Problem, null: Point, chosen: Point) -> HeldOut:
    """Errors of the null and of the chosen causes, both refitted without what they predict."""
    before = _nrmse(problem, _errors(problem, null))
    after = before if chosen is null else _nrmse(problem, _errors(problem, chosen))
    return HeldOut(before, after, _nrmse(problem, None))


def _errors(problem: Problem, point: Point) -> list[Array]:
    """Squared residuals of what was predicted, split by split, as `_nrmse` takes them."""
    errors = []
    for shown, scored in _splits(problem):
        fitted = Problem(problem.case, problem.noise_kPa, shown).fit(point).point
        squares = [r**2 for r in problem.residuals(fitted)]
        errors.append(np.concatenate([s[:, mask] for s, mask in zip(squares, scored, strict=True)], 1))
    return errors


def _splits(problem: Problem) -> Iterator[tuple[list[Bools], list[Bools]]]:
    """Samples that the fit is shown, and samples that are scored, run by run."""
    times = [run.time_s - run.time_s[0] for run in problem.case.runs]
    beginnings = [t < SHOWN_S for t in times]
    nothing = [np.zeros(len(t), dtype=np.bool_) for t in times]
    everything = [~mask for mask in nothing]
    if len(times) > 1:
        for i in range(len(times)):
            shown, scored = list(everything), list(nothing)
            shown[i], scored[i] = beginnings[i], ~beginnings[i]
            yield shown, scored
        return
    late = times[0] > times[0][-1] / 2.0
    for scored in (late, ~late & ~beginnings[0]):
        yield [~scored], [scored]


def _nrmse(problem: Problem, squares: list[Array] | None) -> float:
    """`squares`: (2, n) of residuals in units of noise, 0 where nothing was measured; None is noise alone."""
    shares = []
    for row, noise_kPa in enumerate(problem.noise_kPa):
        measured = [
            data[row][weight[row] > 0.0] for data, weight in zip(problem.data, problem.weights, strict=True)
        ]
        values = np.concatenate(measured)
        if not len(values) or np.ptp(values) == 0.0:
            continue
        mean = 1.0
        if squares is not None:
            together = np.concatenate([s[row] for s in squares])
            mean = float(together.sum() / max(1, np.count_nonzero(together)))
        shares.append(mean * (noise_kPa / float(np.ptp(values))) ** 2)
    return float(np.sqrt(np.mean(shares)))
