"""Diagnoses a case: searches for the cause and builds the verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import exp, isfinite, sqrt

import numpy as np
from threadpoolctl import threadpool_limits

from flying_vines.identification.case import Case
from flying_vines.identification.cores import mapped
from flying_vines.identification.evidence import evidence
from flying_vines.identification.fit import FitProblem
from flying_vines.identification.held_out import HeldOut, Split, held_out, splits_for, unseen_error
from flying_vines.identification.intervals import LikelihoodProfile, profile
from flying_vines.identification.noise import noise_kPa, stated_noise_kPa
from flying_vines.identification.plan import recommend
from flying_vines.identification.search import CLAIM, Candidate, Progress, Search, SearchResult, silent
from flying_vines.identification.verdict import NONE, UNEXPLAINED, Named, ParameterEstimate, Tried, Verdict
from flying_vines.physics.cause import Cause
from flying_vines.physics.effects import catalogue

INDISTINGUISHABLE = 9.2
"""Maximum score difference (an evidence ratio of 100) of candidates that the data cannot tell apart."""
_UNKNOWN_CAUSE = 0.02
"""Prior probability of a cause that is not in the catalogue and looks like noise."""
_MISSED_CAUSE = 0.1
"""Probability that an unexplained remainder is a cause of the catalogue that the search has missed."""
_SCORED = 4
"""Number of best candidates that are tested on unseen data."""
_ON_BOUND = 1e-6
"""A parameter nearer than this share of its range to a bound is on the bound."""


def diagnose(case: Case, causes: Sequence[Cause] | None = None, progress: Progress = silent) -> Verdict:
    """Finds the cause of the difference between simulation and data, and measures it.

    Args:
        case: the recorded runs and the nominal rig.
        causes: causes to test; default: the whole catalogue.
        progress: called with the current step, and the share of the work that is done.
    """
    every = catalogue() if causes is None else causes
    # The fits already use all cores: more BLAS threads would only slow the small matrices down.
    with threadpool_limits(1):
        stated = stated_noise_kPa(case.rig)
        found = Search(FitProblem(case, stated), every).best(progress)
        noise = _noise_left(found.chosen)
        if noise != stated:
            progress("again, with the noise of the data", 0.0)
            found = Search(FitProblem(case, noise), every).best(progress)
        return _verdict(found, progress)


def _noise_left(chosen: Candidate) -> tuple[float, float]:
    """Stated noise of the sensors; if the residuals contradict it, the noise estimated from them."""
    problem = chosen.problem
    found = []
    for row, stated_kPa in enumerate(problem.noise_kPa):
        residuals = [
            np.where(w[row] > 0.0, r[row] * stated_kPa, np.nan)
            for r, w in zip(chosen.fit.residuals, problem.weights, strict=True)
        ]
        found.append(noise_kPa(residuals, stated_kPa))
    return found[0], found[1]


def _verdict(found: SearchResult, progress: Progress) -> Verdict:
    chosen, problem = found.chosen, found.chosen.problem
    progress("intervals", 0.85)
    parameters = [(i, n) for i, cause in enumerate(chosen.causes) for n in range(len(cause.parameters))]
    profiles = mapped(lambda parameter: profile(chosen, *parameter), parameters)
    progress("unseen data", 0.9)
    splits = splits_for(problem, chosen.fit.point, profiles)
    null = found.search.null
    errors = held_out(problem, splits, None if chosen is null else null.fit.point)
    left = None if chosen.adequate else chosen.patterns[0]
    unexplained = Verdict(
        cause=UNEXPLAINED,
        confidence=1.0 - _MISSED_CAUSE,
        indistinguishable=(),
        parameters={},
        also=(),
        numbers={},
        held_out=errors,
        ranking=_ranking(found, splits, errors),
        next_experiment="Repeat the run that fits worst with one valve moved at a time.",
        remainder=f"{left.channel}: {left.feature}" if left else "",
        remarks=(*problem.case.remarks, *_noise_remarks(problem)),
        evidence=evidence(found, profiles),
    )
    if left is not None:
        return unexplained
    known = replace(unexplained, numbers=problem.moved(chosen.fit.point), next_experiment="")
    if not chosen.causes:
        others = [c.score - chosen.score for c in found.tried if c.causes]
        doubt = sum(exp(-0.5 * max(0.0, d)) for d in others[:5]) * 0.05
        return replace(known, cause=NONE, confidence=1.0 / (1.0 + doubt + _UNKNOWN_CAUSE))
    main, further = _main_first(chosen, found)
    doubts = _doubts(chosen, (main, *further), found)
    named = {cause.name: _measured(cause.name, profiles) for cause in chosen.causes}
    return replace(
        known,
        cause=main,
        confidence=_confidence(chosen, main, found),
        indistinguishable=tuple(dict.fromkeys(name for others in doubts.values() for name in others)),
        parameters=named[main],
        also=tuple(Named(name, named[name]) for name in further),
        next_experiment=_next_experiment(problem.case, doubts),
    )


def _noise_remarks(problem: FitProblem) -> list[str]:
    """Remarks where the data contradict the stated noise."""
    sensors = problem.case.rig.sensors
    stated = {
        "cv_noise_std_kPa": sensors.cv_noise_std_kPa,
        "reservoir_noise_std_kPa": sensors.reservoir_noise_std_kPa,
    }
    return [
        f"{key} is {value:g} in the rig file; the data give {used:.3g}, which is used"
        for (key, value), used in zip(stated.items(), problem.noise_kPa, strict=True)
        if used != value
    ]


def _ranking(found: SearchResult, splits: Sequence[Split], errors: HeldOut) -> tuple[Tried, ...]:
    best: dict[frozenset[str], Candidate] = {}
    for candidate in found.tried:
        if not isfinite(candidate.score):
            continue
        key = frozenset(candidate.names)
        if key not in best or candidate.score < best[key].score:
            best[key] = candidate
    ranked = sorted(best.values(), key=lambda candidate: candidate.score)
    known = {(): errors.nrmse_before, found.chosen.names: errors.nrmse_after}
    for candidate in ranked[:_SCORED]:
        if candidate.names not in known:
            known[candidate.names] = unseen_error(candidate.problem, splits, candidate.fit.point)
    return tuple(
        Tried(
            named=tuple(Named(cause.name, _roughly(candidate, cause)) for cause in candidate.causes),
            on_bound=_on_bound(candidate),
            chi2_per_reading=candidate.fit.chi2 / candidate.problem.readings,
            score=candidate.score - ranked[0].score,
            unseen_nrmse=known.get(candidate.names),
        )
        for candidate in ranked
    )


def _roughly(candidate: Candidate, cause: Cause) -> dict[str, ParameterEstimate]:
    """Parameters of one cause, with intervals from the curvature of χ²."""
    point = candidate.fit.point
    index = point.causes.index(cause)
    at = len(point.deviation) + sum(len(c.parameters) for c in point.causes[:index])
    estimates = {}
    for number, (parameter, value) in enumerate(zip(cause.parameters, point.values[index], strict=True)):
        reach = 1.96 * sqrt(max(0.0, candidate.covariance[at + number, at + number]))
        searched = parameter.to_search(value)
        estimates[parameter.name] = ParameterEstimate(
            value, parameter.within(searched - reach), parameter.within(searched + reach)
        )
    return estimates


def _on_bound(candidate: Candidate) -> tuple[str, ...]:
    point = candidate.fit.point
    return tuple(
        parameter.name
        for cause, values in zip(point.causes, point.values, strict=True)
        for parameter, value in zip(cause.parameters, values, strict=True)
        if parameter.share(value) < _ON_BOUND or parameter.share(value) > 1.0 - _ON_BOUND
    )


def _main_first(chosen: Candidate, found: SearchResult) -> tuple[str, list[str]]:
    """The cause that alone gives the lowest χ², and the others."""
    alone = {c.names[0]: c.fit.chi2 for c in found.tried if len(c.names) == 1}
    names = sorted(chosen.names, key=lambda name: alone[name])
    return names[0], names[1:]


def _instead(chosen: Candidate, cause: str, found: SearchResult) -> dict[str, float]:
    """Score increase if `cause` is replaced by another cause; key: the name of the other cause."""
    rest = set(chosen.names) - {cause}
    worse: dict[str, float] = {}
    for candidate in found.tried:
        others = set(candidate.names) - rest
        if rest <= set(candidate.names) and len(others) == 1:
            (name,) = others
            worse[name] = min(candidate.score - chosen.score, worse.get(name, np.inf))
    return worse


def _doubts(chosen: Candidate, names: Sequence[str], found: SearchResult) -> dict[str, tuple[str, ...]]:
    """For each cause, the causes that explain the data equally well, the most likely first.

    Causes without such an alternative are left out.
    """
    doubts = {}
    for cause in names:
        worse = _instead(chosen, cause, found)
        near = [name for name in sorted(worse, key=worse.__getitem__) if worse[name] < INDISTINGUISHABLE]
        if others := tuple(name for name in near if name not in names):
            doubts[cause] = others
    return doubts


def _confidence(chosen: Candidate, main: str, found: SearchResult) -> float:
    """Probability that the true cause is the main cause or one that the data cannot tell apart from it."""
    worse = _instead(chosen, main, found)
    worse[NONE] = max(0.0, found.search.null.score - CLAIM - chosen.score)
    weight = {name: exp(-0.5 * by) for name, by in worse.items()}
    inside = sum(weight[name] for name, by in worse.items() if name != NONE and by < INDISTINGUISHABLE)
    return inside / sum(weight.values()) * (1.0 - _UNKNOWN_CAUSE)


def _next_experiment(case: Case, doubts: Mapping[str, Sequence[str]]) -> str:
    """The recording that separates the first of the doubts."""
    if not doubts:
        return ""
    cause, others = next(iter(doubts.items()))
    return recommend(case.rig, {cause, *others}).in_words()


def _measured(cause: str, profiles: Sequence[LikelihoodProfile]) -> dict[str, ParameterEstimate]:
    """The parameters of a cause, with their intervals."""
    return {
        p.parameter.name: ParameterEstimate(p.estimate, p.low, p.high) for p in profiles if p.cause == cause
    }
