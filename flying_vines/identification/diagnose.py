"""Diagnoses a case: searches for the cause and builds the verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import exp, isfinite, sqrt

import numpy as np
from threadpoolctl import threadpool_limits

from flying_vines.identification.candidate import CLAIM, Candidate
from flying_vines.identification.case import Case
from flying_vines.identification.evidence import evidence
from flying_vines.identification.fit import FitProblem
from flying_vines.identification.held_out import HeldOut, Prediction, held_out, predictions_for, unseen_error
from flying_vines.identification.intervals import LikelihoodProfile, profile, widening
from flying_vines.identification.next_experiment import after_doubts, after_remainder, with_one_more
from flying_vines.identification.noise import Noise, measured_noise, stated_noise
from flying_vines.identification.search import Progress, Search, SearchResult, silent
from flying_vines.identification.simulate import mapped
from flying_vines.identification.verdict import (
    NONE,
    UNEXPLAINED,
    Named,
    ParameterEstimate,
    Remainder,
    Tried,
    Verdict,
)
from flying_vines.physics.arrays import Array
from flying_vines.physics.cause import Cause
from flying_vines.physics.effects import causes_of
from flying_vines.physics.rig import Vessel

INDISTINGUISHABLE = 9.2
"""Maximum score difference (an evidence ratio of 100) of candidates that the data cannot tell apart."""
_UNKNOWN_CAUSE = 0.02
"""Prior probability of a cause that is not in the catalogue and looks like noise."""
_MISSED_CAUSE = 0.1
"""Probability that an unexplained remainder is a cause of the catalogue that the search has missed."""
_LEADS_WITH_REMAINDER = 0.6
"""Probability that the main cause is right although a small remainder is left. The cause may imitate an
effect outside the catalogue. Measured on rigs with such an effect: docs/diagnose.md."""
_SCORED = 4
"""Number of best candidates that are tested on unseen data."""
_HELPS = 0.5
"""Causes that leave a remainder are named if they remove this share of the squared error on unseen data."""
_OTHER_NOISE = 0.1
"""The search is repeated if the noise estimated from its residuals differs by more than this share."""


def diagnose(case: Case, causes: Sequence[Cause] | None = None, progress: Progress = silent) -> Verdict:
    """Finds the causes of the difference between simulation and data, and measures them.

    Args:
        case: the recorded runs and the nominal rig.
        causes: causes to test; default: those of the catalogue that this rig can have.
        progress: called with the current step, and the share of the work that is done.
    """
    largest_kPa = _largest_kPa(case)
    tested = possible_causes(case) if causes is None else causes
    every = [cause.within_readings(largest_kPa) for cause in tested]
    # The fits already use all cores: more BLAS threads would only slow the small matrices down.
    with threadpool_limits(1):
        stated = stated_noise(case.rig, [np.stack((run.cv_kPa, run.reservoir_kPa)) for run in case.runs])
        search = Search(FitProblem(case, stated), every)
        noise = _noise_left(search.null, stated, may_correlate=False)
        # Misfit of the null model can only raise this estimate, so only a lower one is used.
        noise = min(noise[0], stated[0]), min(noise[1], stated[1])
        if noise != stated:
            search = Search(FitProblem(case, noise), every)
        found = search.best(progress)
        left = _noise_left(found.chosen, stated, may_correlate=True)
        ratios = [a.slow_std_kPa / b.slow_std_kPa for a, b in zip(left, noise, strict=True)]
        if any(abs(ratio - 1.0) > _OTHER_NOISE for ratio in ratios):
            progress("again, with the noise of the data", 0.0)
            found = Search(FitProblem(case, left), every).resumed(found, progress)
        if not found.chosen.adequate:
            found = found.search.together(found, progress)
        return _verdict(found, progress)


def possible_causes(case: Case) -> list[Cause]:
    """The causes that the rig can have. If ambient pressure was recorded, its change is not a cause."""
    recorded = all(run.ambient_kPa is not None for run in case.runs)
    return [cause for cause in causes_of(case.rig) if not (recorded and cause.name == "ambient_drop")]


def _largest_kPa(case: Case) -> dict[Vessel, float]:
    """The largest reading of each sensor, positive or negative, as a size in kPa; 0 if there is none."""

    def largest(readings: Array) -> float:
        return float(np.max(np.abs(readings[np.isfinite(readings)]), initial=0.0))

    return {
        "cv": largest(np.concatenate([run.cv_kPa for run in case.runs])),
        "reservoir": largest(np.concatenate([run.reservoir_kPa for run in case.runs])),
    }


def _noise_left(candidate: Candidate, stated: Noise, *, may_correlate: bool) -> Noise:
    """Stated noise of the sensors; if the residuals contradict it, the noise estimated from them."""
    problem = candidate.problem
    found = []
    for row, unit_kPa in enumerate(problem.noise_kPa):
        residuals = [
            np.where(w[row] > 0.0, r[row] * unit_kPa, np.nan)
            for r, w in zip(candidate.fit.residuals, problem.weights, strict=True)
        ]
        found.append(measured_noise(residuals, stated[row], may_correlate=may_correlate))
    return found[0], found[1]


def _verdict(found: SearchResult, progress: Progress) -> Verdict:
    chosen, problem = found.chosen, found.chosen.problem
    progress("intervals", 0.85)
    jacobian = problem.jacobian(chosen.fit)
    wider = widening(chosen, jacobian)
    parameters = [(i, n) for i, cause in enumerate(chosen.causes) for n in range(len(cause.parameters))]
    profiles = mapped(lambda parameter: profile(chosen, *parameter, wider, jacobian), parameters)
    progress("unseen data", 0.9)
    predictions = predictions_for(problem, chosen.fit.point, jacobian, profiles)
    null = found.search.null
    errors = held_out(problem, predictions, None if chosen is null else null.fit.point)
    nothing = Verdict(
        cause=UNEXPLAINED,
        confidence=1.0 - _MISSED_CAUSE,
        indistinguishable=(),
        parameters={},
        share=0.0,
        also=(),
        numbers={},
        held_out=errors,
        ranking=_ranking(found, predictions, errors),
        next_experiment="",
        remainder=_remainder(null, null),
        remarks=(*problem.case.remarks, *_noise_remarks(problem)),
        evidence=evidence(found, profiles),
    )
    known = replace(nothing, numbers=problem.moved(chosen.fit.point), remainder=_remainder(chosen, null))
    if not chosen.causes:
        if not chosen.adequate:
            return replace(nothing, next_experiment=after_remainder(found, null))
        others = [found.score(c) - found.score(chosen) for c in found.tried if c.causes and c.within_bounds]
        doubt = sum(exp(-0.5 * max(0.0, d)) for d in others[:5]) * 0.05
        return replace(known, cause=NONE, confidence=1.0 / (1.0 + doubt + _UNKNOWN_CAUSE))
    if not chosen.adequate and not (errors.gain[0] > 0.0 and errors.explained > _HELPS):
        return replace(nothing, next_experiment=after_remainder(found, null))
    shares = _shares(found)
    main, *further = sorted(shares, key=lambda name: -shares[name])
    doubts = _doubts(chosen, (main, *further), found)
    named = {cause.name: _measured(cause.name, profiles) for cause in chosen.causes}
    experiment = ""
    if doubts:
        experiment = after_doubts(found, doubts)
    elif not chosen.adequate:
        experiment = after_remainder(found, chosen)
    return replace(
        known,
        cause=main,
        confidence=_confidence(chosen, main, found, known.remainder),
        indistinguishable=tuple(dict.fromkeys(name for others in doubts.values() for name in others)),
        parameters=named[main],
        share=shares[main],
        also=tuple(Named(name, named[name], shares[name]) for name in further),
        next_experiment=experiment,
    )


def _shares(found: SearchResult) -> dict[str, float]:
    """For each cause: the rise of χ² without it, divided by the fall of χ² by all causes together."""
    chosen = found.chosen
    if len(chosen.causes) == 1:
        return {chosen.names[0]: 1.0}
    removed = found.search.null.fit.chi2 - chosen.fit.chi2
    return {
        # At most 1: without this cause, the others may fit worse than the baseline.
        # An example is cooling without the flow law.
        name: min(1.0, max(0.0, less.fit.chi2 - chosen.fit.chi2) / removed)
        for name, less in zip(chosen.names, found.without, strict=True)
    }


def _remainder(chosen: Candidate, null: Candidate) -> Remainder | None:
    """The part of the null model's misfit above noise that a candidate leaves; None if only noise is left."""
    if chosen.adequate:
        return None
    noise = sum(
        np.count_nonzero(w[row]) * sensor.variance_over_slow
        for w in chosen.problem.weights
        for row, sensor in enumerate(chosen.problem.noise)
    )
    pattern = chosen.patterns[0]
    share = 1.0
    if chosen is not null and null.fit.chi2 > noise:
        share = min(1.0, max(0.0, chosen.fit.chi2 - noise) / (null.fit.chi2 - noise))
    return Remainder(float(share), f"{pattern.channel}: {pattern.feature}")


def _noise_remarks(problem: FitProblem) -> list[str]:
    """Remarks where the data contradict the stated noise."""
    remarks = []
    for key, used in zip(("cv_noise_std_kPa", "reservoir_noise_std_kPa"), problem.noise, strict=True):
        stated, rho = getattr(problem.case.rig.sensors, key), used.correlation
        if abs(used.std_kPa - stated) > 0.05 * stated or rho:
            how = f" with a correlation of {rho:.2f} between readings" if rho else ""
            found = f"the data give {used.std_kPa:.3g}{how}, which is used"
            remarks.append(f"{key} is {stated:g} in the rig file; {found}")
    return remarks


def _ranking(found: SearchResult, predictions: Sequence[Prediction], errors: HeldOut) -> tuple[Tried, ...]:
    best: dict[frozenset[str], Candidate] = {}
    for candidate in found.tried:
        if not isfinite(candidate.fit.chi2):
            continue
        key = frozenset(candidate.names)
        if key not in best or found.score(candidate) <= found.score(best[key]):
            best[key] = candidate
    ranked = sorted(best.values(), key=found.score)
    known = {(): errors.nrmse_before, found.chosen.names: errors.nrmse_after}
    for candidate in ranked[:_SCORED]:
        if candidate.names not in known:
            known[candidate.names] = unseen_error(candidate.problem, predictions, candidate.fit.point)
    return tuple(
        Tried(
            named=tuple(Named(cause.name, _estimates(candidate, cause), None) for cause in candidate.causes),
            on_bound=candidate.on_bound,
            chi2_per_reading=candidate.fit.chi2 / candidate.problem.readings,
            score=found.score(candidate) - found.score(ranked[0]),
            unseen_nrmse=known.get(candidate.names),
        )
        for candidate in ranked
    )


def _estimates(candidate: Candidate, cause: Cause) -> dict[str, ParameterEstimate]:
    """Parameters of one cause, with intervals from the curvature of χ²."""
    point = candidate.fit.point
    index = point.causes.index(cause)
    columns = candidate.columns(index)
    estimates = {}
    for parameter, value, at in zip(cause.parameters, point.values[index], columns, strict=True):
        reach = 1.96 * sqrt(max(0.0, candidate.covariance[at, at]))
        searched = parameter.to_search(value)
        estimates[parameter.name] = ParameterEstimate(
            value, parameter.within(searched - reach), parameter.within(searched + reach)
        )
    return estimates


def _instead(chosen: Candidate, cause: str, found: SearchResult) -> dict[str, float]:
    """Score increase if `cause` is replaced by another cause; key: the name of the other cause."""
    candidates = with_one_more(found, set(chosen.names) - {cause})
    return {name: found.score(candidate) - found.score(chosen) for name, candidate in candidates.items()}


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


def _confidence(chosen: Candidate, main: str, found: SearchResult, left: Remainder | None) -> float:
    """Probability that the true cause is the main cause or one that the data cannot tell apart from it."""
    worse = {**_instead(chosen, main, found), main: 0.0}
    worse[NONE] = max(0.0, found.score(found.search.null) - CLAIM - found.score(chosen))
    weight = {name: exp(-0.5 * by) for name, by in worse.items()}
    inside = sum(weight[name] for name, by in worse.items() if name != NONE and by < INDISTINGUISHABLE)
    known = 1.0 - _UNKNOWN_CAUSE if left is None else _LEADS_WITH_REMAINDER * (1.0 - sqrt(left.share))
    return inside / sum(weight.values()) * known


def _measured(cause: str, profiles: Sequence[LikelihoodProfile]) -> dict[str, ParameterEstimate]:
    """The parameters of a cause, with their intervals."""
    return {
        p.parameter.name: ParameterEstimate(p.estimate, p.low, p.high) for p in profiles if p.cause == cause
    }
