"""The next experiment: runs that separate the causes between which the data leave a doubt.

If several causes explain the data equally well, the runs separate these causes. If a remainder is left, or
nothing explains the data, the runs separate the further causes with the best scores. Each cause has the
strength that fits these data best. The causes that are not in doubt stay in the rig, with their estimates and
errors as priors. The noise is raised to the size of the best fit's residuals.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from math import inf, sqrt

import numpy as np

from flying_vines.identification.candidate import Candidate
from flying_vines.identification.plan import MAX_S, RecordingPlanError, recommend
from flying_vines.identification.plan.library import FULL_KPA, MAX_KPA, OUTLETS
from flying_vines.identification.search import SearchResult
from flying_vines.physics.arrays import Array
from flying_vines.physics.cause import Cause, Values
from flying_vines.physics.effects import NONE
from flying_vines.physics.rig import with_numbers

CANDIDATES = 4
"""Number of further causes to separate if a remainder is left."""


def after_doubts(found: SearchResult, doubts: Mapping[str, Sequence[str]]) -> str:
    """The recording that separates the first cause in doubt from those that fit equally well, in words."""
    chosen = found.chosen
    cause, others = next(iter(doubts.items()))
    rest = set(chosen.names) - {cause}
    candidates = with_one_more(found, rest)
    return _in_words(found, chosen, {name: candidates[name] for name in (cause, *others)}, rest)


def after_remainder(found: SearchResult, base: Candidate) -> str:
    """The recording that shows which further cause explains the residuals of the base, in words."""
    candidates = with_one_more(found, base.names)
    if not candidates:
        more = found.search.further([base])
        candidates = {c.names[-1]: c for c in more if c.within_bounds}
    over = base.excess
    nearest = sorted(candidates, key=lambda name: candidates[name].score_at(over))[:CANDIDATES]
    if not nearest:
        return ""
    return _in_words(found, base, {name: candidates[name] for name in nearest}, base.names)


def with_one_more(found: SearchResult, rest: Collection[str]) -> dict[str, Candidate]:
    """For each cause: the best candidate `within_bounds` that contains this cause and those in `rest`."""
    best: dict[str, Candidate] = {}
    for candidate in found.tried:
        others = set(candidate.names) - set(rest)
        if candidate.within_bounds and set(rest) <= set(candidate.names) and len(others) == 1:
            (name,) = others
            if name not in best or found.score(candidate) < found.score(best[name]):
                best[name] = candidate
    return best


def _in_words(
    found: SearchResult, base: Candidate, candidates: Mapping[str, Candidate], known: Collection[str]
) -> str:
    causes = {cause.name: cause for cause in found.search.catalogue}
    doubt = [causes[name] for name in candidates]
    fitted = {name: _values(candidate, name) for name, candidate in candidates.items()}
    problem = base.problem
    excess = min(candidates.values(), key=lambda candidate: candidate.fit.chi2).excess
    case = problem.case
    noise = []
    for sensor, over, row in zip(problem.noise, excess, (0, 1), strict=True):
        read = any(used[row].any() for used in problem.used)
        noise.append(sensor._replace(std_kPa=sqrt(over) * sensor.std_kPa if read else inf))
    # A reservoir alone counts as one without valves if no run has opened it.
    opened = any(run.evp_opening.any() or run.dvp_opening.any() for run in case.runs)
    try:
        found_runs = recommend(
            with_numbers(case.rig, problem.moved(base.fit.point)),
            doubt if len(doubt) > 1 else [*doubt, NONE],
            [_known(base, index) for index, name in enumerate(base.names) if name in known],
            fitted,
            (noise[0], noise[1]),
            most_kPa=_highest([run.cv_kPa for run in case.runs], MAX_KPA),
            full_kPa=_highest([run.reservoir_kPa for run in case.runs], FULL_KPA),
            max_s=max(MAX_S, *(float(np.ptp(run.time_s)) for run in case.runs)),
            outlets=OUTLETS if opened or case.rig.cv is not None else (),
        )
    except RecordingPlanError:  # The rig cannot do any run of the library.
        return doubt[0].experiment
    words = found_runs.in_words()
    return words if found_runs.any_separated else f"{words} {doubt[0].experiment}"


def _values(candidate: Candidate, name: str) -> Values:
    """The fitted values of one cause."""
    return candidate.fit.point.values[candidate.names.index(name)]


def _known(base: Candidate, index: int) -> tuple[Cause, Values]:
    """A cause of the base with its values. The errors of the values become the priors of the parameters.

    An error is at most the standard deviation of a uniform distribution over the parameter's range.
    """
    cause, values = base.causes[index], base.fit.point.values[index]
    variance = max(base.excess) * np.diag(base.covariance)[base.columns(index)]
    parameters = tuple(
        replace(
            parameter,
            typical=(parameter.to_search(value), sqrt(max(min(own, parameter.range**2 / 12.0), 1e-18))),
        )
        for parameter, value, own in zip(cause.parameters, values, variance.tolist(), strict=True)
    )
    return replace(cause, parameters=parameters), values


def _highest(readings: Sequence[Array], otherwise: float) -> float:
    """The highest recorded pressure: the rig can reach it again."""
    tops = [float(np.nanmax(kPa)) for kPa in readings if np.isfinite(kPa).any()]
    return max(tops) if tops and max(tops) > 0.0 else otherwise
