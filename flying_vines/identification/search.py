"""Searches the causes that explain the data: none, then each alone, then several, while more causes pay.

Every candidate is fitted twice: with nominal rig numbers, and with all of them free within their tolerances.
The data decide between both. The free fit gets a penalty: the logarithm of prior volume over posterior
volume of these numbers.

A further cause pays if the score falls by `CLAIM`. While the residuals are more than noise, any cause can
imitate a part of an effect that the catalogue lacks. So χ² is then divided by the residuals' excess over
noise (`residuals.excess`), and the error on unseen data must fall for sure.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from math import inf

import numpy as np

from flying_vines.identification.cores import mapped
from flying_vines.identification.fit import Fit, FitProblem, Tangents
from flying_vines.identification.residuals import Pattern, excess, patterns
from flying_vines.identification.simulate import rig_number_keys
from flying_vines.identification.unseen import Unseen
from flying_vines.physics.arrays import Array
from flying_vines.physics.cause import Cause, Parameter

CLAIM = 25.0
"""Minimum score gain of a cause. By chance, the best of 20 wrong causes gains 20 in 1 of 10,000 cases."""
CLAIM_LEFT = 10.0
MIN_GAIN = 0.02
"""If the residuals are more than noise, a cause needs this gain, and this error reduction on unseen data."""
STRUCTURE = 6.0
"""−log₁₀ p: from this value on, a pattern in the residuals is not noise."""
SURELY = 4.0
"""A cause surely pays if its parameter is so far from neutral that χ² would rise by this times `CLAIM`."""
MAX_CAUSES = 9
FIRSTS = 5
"""Number of best single causes that are tried with a second one: one may hide another."""
BEAM = 2
"""Number of best sets of two or more causes that are tried with a further one."""
PROMISING = 4
"""Number of further causes that are fitted: those with the largest expected gain."""
LEADERS, LEADERS_LEFT = 6, 3
"""Number of fits that are completed: those with the lowest χ² after their first steps. Fewer of several
causes while even the best leaves more than noise: the next cause decides then."""
REACH, REACH_SHARE = 2000.0, 0.1
"""An unfinished fit may still lower χ² by 2000 + 10 % of the null model's excess. Others are dropped."""
OF_RANGE = 1e-3
ON_BOUND = 1e-6
"""A parameter nearer than this share of its range to a bound is on the bound."""


Progress = Callable[[str, float], None]
"""Called with the current step, and the share of the work that is done."""


def silent(step: str, share: float) -> None:
    """The default: no progress report."""


@dataclass(frozen=True)
class Candidate:
    """A fit with some causes, or with none."""

    problem: FitProblem
    fit: Fit

    @property
    def causes(self) -> tuple[Cause, ...]:
        return self.fit.point.causes

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(cause.name for cause in self.causes)

    def doubtful(self) -> list[int]:
        """The causes whose parameters may be neutral, by the curvature of χ²; the others surely pay."""
        found, at = [], len(self.fit.point.deviation)
        spread = max(self.excess) * np.diag(self.covariance)
        for index, (cause, values) in enumerate(zip(self.causes, self.fit.point.values, strict=True)):
            sure = (
                parameter.distance(value) ** 2 > SURELY * CLAIM * variance
                for parameter, value, variance in zip(cause.parameters, values, spread[at:], strict=False)
            )
            at += len(values)
            if not any(sure):
                found.append(index)
        return found

    def in_units_of(self, problem: FitProblem) -> Candidate:
        """The same fit, in units of the noise of another problem with the same data."""
        ratio = np.array(self.problem.noise_kPa)[:, None] / np.array(problem.noise_kPa)[:, None]
        residuals = tuple(r * ratio for r in self.fit.residuals)
        chi2 = sum(float(np.vdot(r, r)) for r in residuals)
        prior = self.fit.cost - self.fit.chi2
        return Candidate(problem, Fit(self.fit.point, chi2, chi2 + prior, residuals))

    @cached_property
    def covariance(self) -> Array:
        """See `FitProblem.covariance`."""
        return self.problem.covariance(self.fit)

    @property
    def score(self) -> float:
        """The score if the residuals of the best fit are noise; see `score_at`."""
        return self.score_at((1.0, 1.0))

    def score_at(self, excess: tuple[float, float]) -> float:
        """−2 ln of the evidence, up to a constant.

        χ², plus the penalty of free rig numbers, plus ln(number of readings) for each parameter (BIC).

        Args:
            excess: of the residuals of control volume and reservoir over noise; divides their χ².
        """
        parameters = sum(len(cause.parameters) for cause in self.causes)
        chi2 = sum(chi2 / over for chi2, over in zip(self.channels, excess, strict=True))
        return chi2 + self.freedom + parameters * float(np.log(self.problem.readings))

    @cached_property
    def channels(self) -> tuple[float, float]:
        """χ² of control volume and reservoir."""
        cv, reservoir = (sum(float(r[row] @ r[row]) for r in self.fit.residuals) for row in (0, 1))
        return cv, reservoir

    @property
    def on_bound(self) -> tuple[str, ...]:
        """Parameters on a bound of their physical range."""
        return tuple(parameter.name for parameter in self._bounded())

    @property
    def possible(self) -> bool:
        """True if every parameter is inside its physical range."""
        return all(parameter.typical is not None for parameter in self._bounded())

    def _bounded(self) -> Iterator[Parameter]:
        point = self.fit.point
        for cause, values in zip(point.causes, point.values, strict=True):
            for parameter, value in zip(cause.parameters, values, strict=True):
                if not ON_BOUND < parameter.share(value) < 1.0 - ON_BOUND:
                    yield parameter

    @cached_property
    def freedom(self) -> float:
        """Penalty of the free rig numbers: −2 ln of prior at the fit times posterior width (Laplace)."""
        deviation = self.fit.point.deviation
        if not deviation:
            return 0.0
        precision = np.array([self.problem.prior_std(key) ** -2.0 for key in deviation])
        moved = float(precision @ np.array(list(deviation.values())) ** 2)
        k = len(deviation)
        posterior = self.covariance[:k, :k]
        _, log_posterior = np.linalg.slogdet(posterior)
        return moved - float(log_posterior + np.log(precision).sum())

    @cached_property
    def patterns(self) -> list[Pattern]:
        return patterns(self.problem, self.fit)

    @property
    def adequate(self) -> bool:
        """True if the residuals are noise."""
        return not self.patterns or self.patterns[0].log_p < STRUCTURE

    @cached_property
    def excess(self) -> tuple[float, float]:
        """Excess of the residuals over noise, for control volume and reservoir; 1 if they are noise."""
        return (1.0, 1.0) if self.adequate else excess(self.patterns)


class Search:
    """The search for one fit problem; `nulls` are the baseline with fixed and with free rig numbers."""

    def __init__(self, problem: FitProblem, catalogue: Sequence[Cause]) -> None:
        self.problem = problem
        self.catalogue = tuple(catalogue)
        self.keys = rig_number_keys(problem.case.rig)
        start = problem.start()
        exact = problem.fit(start)
        moved = problem.fit(exact.point.freed(self.keys))
        self.nulls = (Candidate(problem, exact), Candidate(problem, moved))
        self.null = min(self.nulls, key=lambda c: c.score)
        self.unseen = Unseen(problem)

    def singles(self) -> list[Candidate]:
        """Fits of each cause alone, the best first."""
        return self._finished([(self.nulls[1], cause) for cause in self.catalogue])

    def _finished(self, pairs: Sequence[tuple[Candidate, Cause]]) -> list[Candidate]:
        """Fits of each base with its further cause, the best first; only the leaders are completed.

        If the best fit is adequate, only fits close to it are completed.
        """
        if not pairs:
            return []
        begun = mapped(lambda pair: self.problem.begun(pair[0].fit.point, pair[1]), pairs)
        first, *others = sorted(begun, key=lambda fit: fit.chi2)
        first = self.problem.fit(first.point)
        best = Candidate(self.problem, first)
        reach, leaders = (
            self._reach(best),
            LEADERS if best.adequate or len(best.causes) == 1 else LEADERS_LEFT,
        )
        near = [fit for fit in others[: leaders - 1] if fit.chi2 < reach]
        fits = [first, *mapped(lambda fit: self.problem.fit(fit.point), near), *others[len(near) :]]
        complete = 1 + len(near)
        fits[:complete] = mapped(self._off_bounds, fits[:complete])
        return [Candidate(self.problem, fit) for fit in sorted(fits, key=lambda fit: fit.chi2)]

    def _off_bounds(self, fit: Fit) -> Fit:
        """The fit; if a parameter is on its bound, the better of it and one that adds the causes in reverse.

        A cause that was fitted without the others may have been driven to its bound.
        """
        if len(fit.point.causes) < 2 or not Candidate(self.problem, fit).on_bound:
            return fit
        again = self.nulls[1].fit
        for cause in reversed(fit.point.causes):
            again = self.problem.begun(again.point, cause)
        return min(fit, self.problem.fit(again.point), key=lambda fit: fit.chi2)

    def _reach(self, first: Candidate) -> float:
        """Maximum χ² of an unfinished fit that can still win."""
        if not first.adequate:
            return inf
        return first.fit.chi2 + REACH + REACH_SHARE * (self.null.fit.chi2 - first.fit.chi2)

    def _leaders(self, bases: Sequence[Candidate]) -> list[Candidate]:
        """The best few, settled; the best first."""
        reach = self._reach(bases[0]) if bases else inf
        settled = mapped(self.settled, [base for base in bases[:FIRSTS] if base.fit.chi2 < reach])
        if not settled:
            return []
        over = min(settled, key=lambda c: c.fit.chi2).excess
        return sorted(settled, key=lambda c: (not c.possible, c.score_at(over)))

    def settled(self, candidate: Candidate) -> Candidate:
        """The same causes, with nominal rig numbers if these explain the data as well.

        A candidate that leaves more than noise keeps its rig numbers free.
        """
        if not candidate.adequate:
            return candidate
        exact = Candidate(self.problem, self.problem.fit(candidate.fit.point.freed(())))
        over = candidate.excess
        return min(exact, candidate, key=lambda c: c.score_at(over))

    def further(self, bases: Sequence[Candidate]) -> list[Candidate]:
        """Fits of the bases with one more cause, the best first; only the most promising are fitted."""
        pairs: dict[frozenset[str], tuple[Candidate, Cause]] = {}
        for base, others in zip(bases, mapped(self._promising, bases), strict=True):
            for cause in others:
                pairs.setdefault(frozenset((*base.names, cause.name)), (base, cause))
        return self._finished(list(pairs.values()))

    def _promising(self, base: Candidate) -> list[Cause]:
        """The further causes with the largest expected gain."""
        tangents = self.problem.tangents(base.fit)
        others = [cause for cause in self.catalogue if cause.name not in base.names]
        return sorted(others, key=lambda cause: -self._promise(base.fit, tangents, cause))[:PROMISING]

    def _promise(self, base: Fit, tangents: Tangents, cause: Cause) -> float:
        """Expected reduction of χ² if the cause's trace is scaled and everything else is refitted."""
        parameter = cause.parameters[0]
        best = 0.0
        for values in cause.seeds():
            seed = parameter.to_search(values[0])
            # A neutral seed has no effect, so a value beside it is also tried.
            for searched in (seed, seed + OF_RANGE * (parameter.to_search(parameter.high) - seed)):
                point = base.point.with_cause(cause, (parameter.to_model(searched), *values[1:]))
                trace = [a - b for a, b in zip(self.problem.residuals(point), base.residuals, strict=True)]
                best = max(best, tangents.gain(trace))
        return best

    def best(self, progress: Progress = silent) -> SearchResult:
        """Run the search."""
        progress("single causes", 0.1)
        bases = self.singles()
        leaders = self._leaders(bases)
        return self._grown([*self.nulls, *bases, *leaders], bases[:FIRSTS], leaders, progress)

    def resumed(self, earlier: SearchResult, progress: Progress = silent) -> SearchResult:
        """Go on from the result of an earlier search of the same data with another noise."""
        tried = [*self.nulls, *(c.in_units_of(self.problem) for c in earlier.tried if c.causes)]
        begun = self.problem.fit(earlier.chosen.fit.point.freed(self.keys))
        chosen = self.settled(Candidate(self.problem, begun))
        return self._grown([*tried, chosen], [chosen], [chosen], progress)

    def _grown(
        self,
        tried: list[Candidate],
        firsts: Sequence[Candidate],
        leaders: Sequence[Candidate],
        progress: Progress,
    ) -> SearchResult:
        """Add causes to the leaders, and exchange them, while that pays."""
        chosen = self.null
        while (better := self._first_that_pays(leaders, chosen)) is not None:
            chosen, fewer = self._pruned(better)
            tried += fewer
            count = len(chosen.causes) + 1
            if chosen.adequate or count > MAX_CAUSES:
                break
            progress(f"{count} causes together", min(0.75, 0.15 * count))
            firsts = firsts if count == 2 else _distinct([chosen, *leaders])[:BEAM]
            leaders = self._leaders(self.further(firsts))
            tried += leaders
            if self._first_that_pays(leaders, chosen) is None and count > 2:
                leaders = self._leaders(self.further(self._vacancies(chosen)))
                tried += leaders
        several = range(len(chosen.causes)) if len(chosen.causes) > 1 else ()
        without = mapped(partial(self._without, chosen), several)
        return SearchResult(self, [*tried, *without], chosen, tuple(without))

    def _first_that_pays(self, leaders: Sequence[Candidate], chosen: Candidate) -> Candidate | None:
        """The best leader that pays in comparison with the chosen candidate; None if none does."""
        return next((leader for leader in leaders if self._pays(leader, chosen)), None)

    def _pays(self, more: Candidate, less: Candidate) -> bool:
        """True if the further causes pay: on the data, and on unseen data if something remains."""
        if not more.possible:
            return False
        gain = less.score_at(more.excess) - more.score_at(more.excess)
        if more.adequate:
            return gain > (CLAIM if len(more.causes) > len(less.causes) else 0.0)
        return gain > CLAIM_LEFT and self.unseen.gain(less.fit.point, more.fit.point)[0] > MIN_GAIN

    def _pruned(self, candidate: Candidate) -> tuple[Candidate, list[Candidate]]:
        """The candidate without causes that no longer pay, and all candidates that were tried."""
        tried: list[Candidate] = []
        while len(candidate.causes) > 1 and (doubtful := candidate.doubtful()):
            fewer = mapped(partial(self._without, candidate), doubtful)
            tried += fewer
            over = candidate.excess
            simpler = min(fewer, key=lambda c: c.score_at(over))
            if simpler.score_at(over) > candidate.score_at(over) + (
                CLAIM if candidate.adequate else CLAIM_LEFT
            ):
                break
            candidate = simpler
        return candidate, tried

    def _vacancies(self, candidate: Candidate) -> list[Candidate]:
        """The candidate without each of its causes in turn, not refitted: another may take its place."""

        def vacant(index: int) -> Candidate:
            point = candidate.fit.point.freed(self.keys).without(index)
            residuals = tuple(self.problem.residuals(point))
            chi2 = sum(float(np.vdot(r, r)) for r in residuals)
            return Candidate(self.problem, Fit(point, chi2, chi2, residuals))

        return mapped(vacant, range(len(candidate.causes)))

    def _without(self, candidate: Candidate, index: int) -> Candidate:
        """The candidate refitted without one of its causes."""
        return self.settled(
            Candidate(self.problem, self.problem.fit(candidate.fit.point.freed(self.keys).without(index)))
        )


def _distinct(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The first candidate of each set of causes."""
    return list({frozenset(c.names): c for c in reversed(candidates)}.values())[::-1]


@dataclass(frozen=True)
class SearchResult:
    """Everything that was tried, and the candidate that explains the data best."""

    search: Search
    tried: list[Candidate]
    chosen: Candidate
    without: tuple[Candidate, ...]
    """The chosen candidate without each of its causes in turn; empty if it has none or one."""

    def score(self, candidate: Candidate) -> float:
        """The score, with χ² over what the chosen candidate leaves."""
        return candidate.score_at(self.chosen.excess)
