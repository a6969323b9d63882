"""Which causes explain the data: the null, then each cause by itself, then further ones, as long as it pays.

Every candidate is fitted twice: with the believed numbers exactly as believed, and with all of them free
within their tolerance. Which of the two holds for a rig is a question to the data as well: the second pays
for its freedom with the logarithm of how much more the data say of the numbers than was believed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf

import numpy as np

from flying_vines.identification.cores import mapped
from flying_vines.identification.fit import Fit, FitProblem, Tangents
from flying_vines.identification.residuals import Pattern, patterns
from flying_vines.identification.simulate import believed_keys
from flying_vines.physics.arrays import Array
from flying_vines.physics.cause import Cause

CLAIM = 25.0
"""By so much a cause must lower the score. Of twenty useless ones the best gains 20 once in 10,000 cases."""
STRUCTURE = 6.0
"""−log₁₀ p: from this value on, a pattern in the residuals is not noise."""
MOST_CAUSES = 3
FIRSTS = 5
"""So many of the best single causes are tried with a second one: one may hide another."""
PROMISING = 4
"""So many further causes are fitted fully, those that promise most."""
LEADERS = 6
"""So many fits, those that have come lowest in their first steps, are fitted to the end."""
REACH, REACH_SHARE = 2000.0, 0.1
"""By so much χ², and this share of all that there is to explain, a fit that has begun may still fall."""
OF_RANGE = 1e-3


Progress = Callable[[str, float], None]
"""Is told what is being done, and which share of all is done."""


def silent(step: str, share: float) -> None:
    """Nobody wants to know."""


@dataclass(frozen=True)
class Candidate:
    """Some causes (or none), fitted."""

    problem: FitProblem
    fit: Fit

    @property
    def causes(self) -> tuple[Cause, ...]:
        return self.fit.point.causes

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(cause.name for cause in self.causes)

    @cached_property
    def covariance(self) -> Array:
        """As `FitProblem.covariance`."""
        return self.problem.covariance(self.fit)

    @cached_property
    def score(self) -> float:
        """Twice the negative logarithm of the evidence, up to a constant: χ², what moving the believed
        numbers cost, and for each parameter what the data had to say to fix it."""
        parameters = sum(len(cause.parameters) for cause in self.causes)
        return self.fit.chi2 + self.freedom + parameters * float(np.log(self.problem.readings))

    @cached_property
    def freedom(self) -> float:
        """What the free believed numbers cost: −2 ln of prior at the fit times posterior width (Laplace)."""
        deviation = self.fit.point.deviation
        if not deviation:
            return 0.0
        sureness = np.array([self.problem.spread(key) ** -2.0 for key in deviation])
        moved = float(sureness @ np.array(list(deviation.values())) ** 2)
        k = len(deviation)
        posterior = self.covariance[:k, :k]
        _, log_posterior = np.linalg.slogdet(posterior)
        return moved - float(log_posterior + np.log(sureness).sum())

    @cached_property
    def patterns(self) -> list[Pattern]:
        return patterns(self.problem, self.fit)

    @property
    def adequate(self) -> bool:
        """Nothing but noise is left."""
        return not self.patterns or self.patterns[0].surprise < STRUCTURE


class Search:
    """Fits of one problem, with what they led to."""

    def __init__(self, problem: FitProblem, catalogue: Sequence[Cause]) -> None:
        self.problem = problem
        self.catalogue = tuple(catalogue)
        self.keys = believed_keys(problem.case.rig)
        start = problem.start()
        exact = problem.fit(start)
        moved = problem.fit(exact.point.freed(self.keys))
        self.nulls = (Candidate(problem, exact), Candidate(problem, moved))
        self.null = min(self.nulls, key=lambda c: c.score)

    def singles(self) -> list[Candidate]:
        """Each cause by itself, the best first."""
        return self._finished([(self.nulls[1], cause) for cause in self.catalogue])

    def _finished(self, pairs: Sequence[tuple[Candidate, Cause]]) -> list[Candidate]:
        """Each base with its further cause, the best first; only the leaders are fitted to the end.

        Where the first of them leaves nothing but noise, only those that come near it are.
        """
        if not pairs:
            return []
        begun = mapped(lambda pair: self.problem.begun(pair[0].fit.point, pair[1]), pairs)
        first, *others = sorted(begun, key=lambda fit: fit.chi2)
        first = self.problem.fit(first.point)
        reach = self._reach(Candidate(self.problem, first))
        near = [fit for fit in others[: LEADERS - 1] if fit.chi2 < reach]
        fits = [first, *mapped(lambda fit: self.problem.fit(fit.point), near), *others[len(near) :]]
        return [Candidate(self.problem, fit) for fit in sorted(fits, key=lambda fit: fit.chi2)]

    def _reach(self, first: Candidate) -> float:
        """To which χ² a fit may have come and still compete with what has come furthest."""
        if not first.adequate:
            return inf
        return first.fit.chi2 + REACH + REACH_SHARE * (self.null.fit.chi2 - first.fit.chi2)

    def _leaders(self, bases: Sequence[Candidate]) -> list[Candidate]:
        """The best few, settled."""
        reach = self._reach(bases[0]) if bases else inf
        return mapped(self.settled, [base for base in bases[:FIRSTS] if base.fit.chi2 < reach])

    def settled(self, candidate: Candidate) -> Candidate:
        """The same causes, with the believed numbers exact if that explains the data as well."""
        exact = Candidate(self.problem, self.problem.fit(candidate.fit.point.freed(())))
        return min(exact, candidate, key=lambda c: c.score)

    def further(self, bases: Sequence[Candidate]) -> list[Candidate]:
        """The bases with one more cause, the best first; only those are fitted that promise most."""
        pairs: dict[frozenset[str], tuple[Candidate, Cause]] = {}
        for base, others in zip(bases, mapped(self._promising, bases), strict=True):
            for cause in others:
                pairs.setdefault(frozenset((*base.names, cause.name)), (base, cause))
        return self._finished(list(pairs.values()))

    def _promising(self, base: Candidate) -> list[Cause]:
        """The causes that promise most beside those that are there."""
        tangents = self.problem.tangents(base.fit)
        others = [cause for cause in self.catalogue if cause.name not in base.names]
        return sorted(others, key=lambda cause: -self._promise(base.fit, tangents, cause))[:PROMISING]

    def _promise(self, base: Fit, tangents: Tangents, cause: Cause) -> float:
        """By how much χ² would fall if the cause's trace were scaled, and all that is fitted moved along."""
        parameter = cause.parameters[0]
        best = 0.0
        for values in cause.seeds():
            seed = parameter.inner(values[0])
            # Where a seed is neutral only its neighbour leaves a trace.
            for inner in (seed, seed + OF_RANGE * (parameter.inner(parameter.high) - seed)):
                point = base.point.with_cause(cause, (parameter.outer(inner), *values[1:]))
                trace = [a - b for a, b in zip(self.problem.residuals(point), base.residuals, strict=True)]
                best = max(best, tangents.gain(trace))
        return best

    def best(self, progress: Progress = silent) -> SearchResult:
        """Everything that was tried, and what explains the data best."""
        progress("single causes", 0.1)
        bases = self.singles()
        leaders = self._leaders(bases)
        tried = [*self.nulls, *bases, *leaders]
        chosen = min([self.null, *leaders], key=lambda c: c.score)
        if chosen.score > self.null.score - CLAIM:
            chosen = self.null
        for count in range(2, MOST_CAUSES + 1):
            if chosen.adequate:
                break
            progress(f"{count} causes together", 0.2 * count)
            firsts = bases[:FIRSTS] if count == 2 else bases[:1]
            bases = self.further(firsts)
            leaders = self._leaders(bases)
            tried += leaders
            better = min((chosen, *leaders), key=lambda c: c.score)
            if better.score > chosen.score - CLAIM:
                break
            chosen = better
        while len(chosen.causes) > 1:
            fewer = [self._without(chosen, index) for index in range(len(chosen.causes))]
            tried += fewer
            least = min(fewer, key=lambda c: c.score)
            if least.score > chosen.score + CLAIM:
                break
            chosen = least
        return SearchResult(self, tried, chosen)

    def _without(self, candidate: Candidate, index: int) -> Candidate:
        """What is left of the evidence without one of the causes."""
        return self.settled(
            Candidate(self.problem, self.problem.fit(candidate.fit.point.freed(self.keys).without(index)))
        )


@dataclass(frozen=True)
class SearchResult:
    search: Search
    tried: list[Candidate]
    chosen: Candidate
