"""From a case to its verdict."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import exp

import numpy as np
from threadpoolctl import threadpool_limits

from flying_vines.discrepancy.case import Case
from flying_vines.discrepancy.cause import Cause
from flying_vines.discrepancy.causes import catalogue
from flying_vines.discrepancy.fit import Problem
from flying_vines.discrepancy.held_out import held_out
from flying_vines.discrepancy.intervals import profile
from flying_vines.discrepancy.noise import noise_kPa
from flying_vines.discrepancy.search import CLAIM, Candidate, Found, Search
from flying_vines.discrepancy.simulate import BELIEVED
from flying_vines.discrepancy.verdict import NONE, UNEXPLAINED, Estimate, Named, Ranked, Verdict

ALIKE = 9.2
"""A candidate whose evidence is within a factor of 100 of the best cannot be told apart from it."""
LEAST_KPA = 1e-3
"""Noise of a sensor that is stated to have none: what is written is rounded."""
_SURPRISE = 0.02
"""How often, before any data, something is there that the catalogue does not hold, and looks like noise."""
_SURPRISE_UNEXPLAINED = 0.1
"""How often what is left after all is a cause of the catalogue after all, that no fit has found."""
Progress = Callable[[str], None]


def diagnose(
    case: Case, causes: Sequence[Cause] | None = None, progress: Progress = lambda step: None
) -> Verdict:
    """Where the baseline simulation departs from a rig's data, why, and what the cause is worth.

    Args:
        case: the recorded runs and the believed rig.
        causes: to be considered; the whole catalogue if not given.
        progress: is told what is being done.
    """
    every = catalogue() if causes is None else causes
    # The fits themselves run on all cores; small matrices on several more would only wait for each other.
    with threadpool_limits(1):
        progress("baseline")
        sensors = case.rig.sensors
        stated = (sensors.cv_noise_std_kPa or LEAST_KPA, sensors.reservoir_noise_std_kPa or LEAST_KPA)
        found = Search(Problem(case, stated), every).best(progress)
        noise = _noise_left(found.chosen)
        if noise != stated:
            progress("again, with the noise that the data have")
            found = Search(Problem(case, noise), every).best(progress)
        progress("held-out runs")
        return _verdict(found.search.problem, found)


def _noise_left(chosen: Candidate) -> tuple[float, float]:
    """The sensors' noise, as stated, or as what the fit leaves tells where that contradicts."""
    problem = chosen.problem
    found = []
    for row, stated_kPa in enumerate(problem.noise_kPa):
        residuals = [
            np.where(w[row] > 0.0, r[row] * stated_kPa, np.nan)
            for r, w in zip(chosen.fit.residuals, problem.weights, strict=True)
        ]
        found.append(noise_kPa(residuals, stated_kPa))
    return found[0], found[1]


def _verdict(problem: Problem, found: Found) -> Verdict:
    chosen = found.chosen
    left = None if chosen.adequate else chosen.patterns[0]
    unexplained = Verdict(
        cause=UNEXPLAINED,
        confidence=1.0 - _SURPRISE_UNEXPLAINED,
        indistinguishable=(),
        parameters={},
        also=(),
        numbers={},
        held_out=held_out(problem, found.search.null.fit.point, chosen.fit.point),
        ranking=_ranking(found.tried),
        next_experiment="Repeat the run that fits worst with one valve moved at a time.",
        remainder=f"{left.channel}: {left.feature}" if left else "",
        remarks=(*problem.case.remarks, *_noise_remarks(problem)),
    )
    if left is not None:
        return unexplained
    believed = problem.simulation.believed
    known = replace(
        unexplained,
        numbers={
            key: getattr(believed, BELIEVED[key]) * (1.0 + moved)
            for key, moved in chosen.fit.point.deviation.items()
        },
        next_experiment="",
    )
    if not chosen.causes:
        others = [c.score - chosen.score for c in found.tried if c.causes]
        doubt = sum(exp(-0.5 * max(0.0, d)) for d in others[:5]) * 0.05
        return replace(known, cause=NONE, confidence=1.0 / (1.0 + doubt + _SURPRISE))
    main, further = _main_first(chosen, found)
    alike, confidence = _alike(chosen, main, found)
    named = _estimates(chosen)
    by_name = {cause.name: cause for cause in found.search.catalogue}
    return replace(
        known,
        cause=main,
        confidence=confidence,
        indistinguishable=alike,
        parameters=named[main],
        also=tuple(Named(name, named[name]) for name in further),
        next_experiment=by_name[main].experiment if alike else "",
    )


def _noise_remarks(problem: Problem) -> list[str]:
    """Where the data contradict what the rig states."""
    sensors = problem.case.rig.sensors
    stated = {
        "cv_noise_std_kPa": sensors.cv_noise_std_kPa,
        "reservoir_noise_std_kPa": sensors.reservoir_noise_std_kPa,
    }
    return [
        f"{key} is stated as {said:g}; the data say {used:.3g}"
        for (key, said), used in zip(stated.items(), problem.noise_kPa, strict=True)
        if used != said
    ]


def _ranking(tried: Sequence[Candidate]) -> tuple[Ranked, ...]:
    scores: dict[frozenset[str], tuple[tuple[str, ...], float]] = {}
    for candidate in tried:
        key = frozenset(candidate.names)
        if key not in scores or candidate.score < scores[key][1]:
            scores[key] = (candidate.names, candidate.score)
    ranked = sorted(scores.values(), key=lambda item: item[1])
    return tuple(Ranked(names, score - ranked[0][1]) for names, score in ranked)


def _main_first(chosen: Candidate, found: Found) -> tuple[str, list[str]]:
    """The cause that explains most by itself, and the others."""
    alone = {c.names[0]: c.fit.chi2 for c in found.tried if len(c.names) == 1}
    names = sorted(chosen.names, key=lambda name: alone[name])
    return names[0], names[1:]


def _alike(chosen: Candidate, main: str, found: Found) -> tuple[tuple[str, ...], float]:
    """What could stand in place of the main cause, and how sure the set of both is."""
    rest = set(chosen.names) - {main}
    scores: dict[str, float] = {}
    for candidate in found.tried:
        others = set(candidate.names) - rest
        if rest <= set(candidate.names) and len(others) == 1:
            (name,) = others
            scores[name] = min(candidate.score, scores.get(name, np.inf))
    inside = [name for name, score in scores.items() if score - chosen.score < ALIKE and name != main]
    weight = {name: exp(-0.5 * (score - chosen.score)) for name, score in scores.items()}
    weight[NONE] = exp(-0.5 * max(0.0, found.search.null.score - CLAIM - chosen.score))
    held = weight[main] + sum(weight[name] for name in inside)
    return tuple(sorted(inside, key=lambda name: scores[name])), held / sum(weight.values()) * (
        1.0 - _SURPRISE
    )


def _estimates(chosen: Candidate) -> dict[str, dict[str, Estimate]]:
    """Parameters of all causes, with their intervals."""
    named = {}
    for index, cause in enumerate(chosen.causes):
        profiles = [profile(chosen, index, number) for number in range(len(cause.parameters))]
        named[cause.name] = {p.parameter.name: Estimate(p.estimate, p.low, p.high) for p in profiles}
    return named
