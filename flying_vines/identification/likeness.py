"""Which causes these data can tell apart, whatever the verdict is.

Around what fits best, each cause is put in as strongly as its fits begin, or taken out if it is in; what that
does to the readings, in units of noise, is its trace. Free initial pressures, and believed numbers within
their tolerances, could imitate a part of it; that part is no evidence, and comes off. With a row of F for
what each number does when it moves by one standard deviation of what is believed of it (Λ = 1), and for each
initial pressure (Λ = 0), the inner products of what is left of the traces T are

    G = T Tᵀ − T Fᵀ (F Fᵀ + Λ)⁻¹ F Tᵀ

Their roots on the diagonal say how plainly a cause would show, their cosines how alike two of them are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flying_vines.identification.fit import Fit, FitPoint, FitProblem
from flying_vines.physics.arrays import Array
from flying_vines.physics.cause import Cause, Values

_UNSEEN = 1e-6
_OF_RANGE = 0.03
"""So far from where it does nothing a cause is put that begins there."""


@dataclass(frozen=True, eq=False)
class Likeness:
    """How alike the traces of causes are in some data, beside all that the baseline can do itself."""

    causes: tuple[str, ...]
    cosine: Array
    """(causes, causes), 0…1: of two traces; 1 if one can stand for the other here."""
    seen: Array
    """(causes,) length of each trace: how many standard deviations of noise the cause would stand out."""


def likeness(problem: FitProblem, fit: Fit, causes: Sequence[Cause], keys: Sequence[str]) -> Likeness:
    """Of all these causes, around a fit.

    Args:
        keys: of the believed numbers that may move.
    """

    slopes = problem.slopes(replace(fit, point=fit.point.freed(keys)))
    spreads = np.array([problem.spread(key) for key in keys])
    f = slopes.free[: len(keys)] * spreads[:, None]

    def trace(point: FitPoint) -> Array:
        residuals = zip(problem.residuals(point), fit.residuals, strict=True)
        whole = [there - here for there, here in residuals]
        return slopes.beside([np.where(np.isfinite(run), run, 0.0) for run in whole])

    traces = [max(map(trace, _changed(fit.point, cause)), key=lambda t: float(t @ t)) for cause in causes]
    t = np.array(traces).reshape(len(causes), f.shape[1])
    shared = t @ f.T
    left = t @ t.T - shared @ np.linalg.inv(f @ f.T + np.eye(len(f))) @ shared.T
    seen = np.sqrt(np.maximum(np.diag(left), 0.0))
    length = np.maximum(seen, _UNSEEN)
    cosine = np.clip(np.abs(left / np.outer(length, length)), 0.0, 1.0)
    return Likeness(tuple(cause.name for cause in causes), cosine, seen)


def _changed(point: FitPoint, cause: Cause) -> Iterator[FitPoint]:
    """Without the cause if it is there, else with it where its fits begin."""
    if cause in point.causes:
        yield point.without(point.causes.index(cause))
        return
    for seed in cause.seeds():
        yield point.with_cause(cause, _at_work(cause, seed))


def _at_work(cause: Cause, seed: Values) -> Values:
    """A seed, or its neighbour if at the seed the cause does nothing."""
    parameter = cause.parameters[0]
    if seed[0] != parameter.neutral:
        return seed
    return (parameter.outer(parameter.inner(seed[0]) + _OF_RANGE * parameter.range), *seed[1:])
