"""The arrays behind a verdict, for figures and notebooks: runs, residuals, and what can be told apart.

Whatever the verdict is, `similarity` shows which causes these data can tell apart. Each cause is added to the
best fit, at the seed with the largest effect; a cause that the fit has is removed instead. The change of the
readings, in units of noise, is the trace of the cause. Free initial pressures, and rig numbers within their
tolerances, can imitate a part of a trace. That part is no evidence and is removed. The traces are the rows of
T. F has one row for each rig number (its effect if it moves by one prior standard deviation, Λ = 1) and for
each initial pressure (Λ = 0). The inner products of the remaining traces are

    G = T Tᵀ − T Fᵀ (F Fᵀ + Λ)⁻¹ F Tᵀ

The square root of a diagonal element of G tells how clearly the data show a cause. The cosine of two traces
tells how similar two causes are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flying_vines.identification.fit import Fit, FitPoint, FitProblem
from flying_vines.identification.intervals import LikelihoodProfile
from flying_vines.identification.residuals import Pattern
from flying_vines.identification.search import SearchResult
from flying_vines.physics.arrays import Array
from flying_vines.physics.cause import Cause


@dataclass(frozen=True, eq=False)
class Compared:
    """A run, measured and simulated. Pressures are (2, n), kPa gauge: control volume, then reservoir."""

    run: str
    time_s: Array
    """(n,)"""
    measured_kPa: Array
    """NaN where nothing was read."""
    baseline_kPa: Array
    """The null model: the baseline with nominal rig numbers, or with numbers refitted within tolerances."""
    extended_kPa: Array
    """With the causes that explain the data best; the null model again if there are none."""
    openings: Array
    """(3, n) valve commands: inflation valve, Venturi's valve (0…1), solenoid (0 or 1)."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """The data on which a verdict is based."""

    runs: tuple[Compared, ...]
    noise_kPa: tuple[float, float]
    """Standard deviations for control volume and reservoir that the fit used."""
    before: tuple[Pattern, ...]
    """Residual patterns of the null model, the strongest first."""
    after: tuple[Pattern, ...]
    """Residual patterns with the causes."""
    profiles: tuple[LikelihoodProfile, ...]
    """One per parameter of the best fit; an `unexplained` verdict does not name the causes of that fit."""
    similarity: Similarity
    """Similarity of all causes of the catalogue, around the best fit."""


def evidence(found: SearchResult, profiles: Sequence[LikelihoodProfile]) -> Evidence:
    """The evidence of a finished search."""
    null, chosen = found.search.null, found.chosen
    problem = chosen.problem
    simulated = zip(problem.simulated(null.fit.point), problem.simulated(chosen.fit.point), strict=True)
    runs = []
    for i, (baseline_kPa, extended_kPa) in enumerate(simulated):
        measured_kPa = np.where(problem.weights[i] > 0.0, problem.data[i], np.nan)
        run = problem.case.runs[i]
        openings = np.stack((run.evp_opening, run.dvp_opening, run.solenoid))
        runs.append(Compared(run.name, run.time_s, measured_kPa, baseline_kPa, extended_kPa, openings))
    return Evidence(
        runs=tuple(runs),
        noise_kPa=problem.noise_kPa,
        before=tuple(null.patterns),
        after=tuple(chosen.patterns),
        profiles=tuple(profiles),
        similarity=similarity(problem, chosen.fit, found.search.catalogue, found.search.keys),
    )


@dataclass(frozen=True, eq=False)
class Similarity:
    """Cosine similarity of the causes' traces, without the part that the baseline can imitate."""

    causes: tuple[str, ...]
    cosine: Array
    """(causes, causes), 0…1; 1 if these data cannot tell the two causes apart."""
    seen: Array
    """(causes,) length of each trace, in standard deviations of noise."""


def similarity(problem: FitProblem, fit: Fit, causes: Sequence[Cause], keys: Sequence[str]) -> Similarity:
    """The similarity of these causes around a fit, with the rig numbers of `keys` free."""
    jacobian = problem.jacobian(replace(fit, point=fit.point.with_free(keys)))
    spreads = np.array([problem.prior_std(key) for key in keys])
    f = jacobian.reduced[: len(keys)] * spreads[:, None]

    def trace(point: FitPoint) -> Array:
        residuals = zip(problem.residuals(point), fit.residuals, strict=True)
        whole = [there - here for there, here in residuals]
        return jacobian.orthogonal_part([np.where(np.isfinite(run), run, 0.0) for run in whole])

    traces = [max(map(trace, _changed(fit.point, cause)), key=lambda t: float(t @ t)) for cause in causes]
    t = np.array(traces).reshape(len(causes), f.shape[1])
    shared = t @ f.T
    left = t @ t.T - shared @ np.linalg.inv(f @ f.T + np.eye(len(f))) @ shared.T
    seen = np.sqrt(np.maximum(np.diag(left), 0.0))
    length = np.maximum(seen, 1e-6)
    cosine = np.clip(np.abs(left / np.outer(length, length)), 0.0, 1.0)
    return Similarity(tuple(cause.name for cause in causes), cosine, seen)


def _changed(point: FitPoint, cause: Cause) -> Iterator[FitPoint]:
    """The point without the cause if it has the cause; otherwise with the cause at, or beside, each seed."""
    if cause in point.causes:
        yield point.without(point.causes.index(cause))
        return
    for seed in cause.seeds():
        yield point.with_cause(cause, (cause.parameters[0].with_effect(seed[0]), *seed[1:]))
