"""Searches for the causes that explain the data.

It tries no cause, then each cause alone, then several causes, until no further cause pays.

Rig numbers are free within their tolerances. The best candidates that leave only noise are also fitted with
nominal rig numbers, and the score decides between the two fits. The fit with free rig numbers gets a penalty:
the logarithm of prior volume over posterior volume of these numbers.

A further cause pays if it lowers the score by more than `CLAIM`. If the residuals are more than noise, an
effect is still missing, and a wrong cause can imitate a part of it. Then χ² is divided by the residuals'
excess over noise (`Candidate.excess`), `CLAIM_LEFT` replaces `CLAIM`, and the interval of the gain on unseen
data must be above `MIN_GAIN`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf, log

from flying_vines.identification.candidate import CLAIM, Candidate
from flying_vines.identification.fit import MAX_SEEDS, MAX_STEPS, ROUGH_GAIN, Fit, FitPoint, FitProblem
from flying_vines.identification.held_out import HeldOutErrors
from flying_vines.identification.jacobian import Tangents
from flying_vines.identification.simulate import mapped, rig_number_keys
from flying_vines.physics.cause import Cause

CLAIM_LEFT = 10.0
MIN_GAIN = 0.02
"""If the residuals are more than noise, a further cause must lower the score by more than `CLAIM_LEFT`, and
the interval of the relative error reduction on unseen data must be above `MIN_GAIN`."""
CLAIM_ON_BOUND = 10.0
"""A parameter on its bound shows that a cause is missing. A further cause that moves the parameter off its
bound needs only this gain."""
MAX_CAUSES = 9
FIRSTS = 5
"""Number of best single causes that are tried with a second cause: the very best one may be a wrong cause."""
BEAM = 2
"""Number of best sets of two or more causes that are tried with a further one."""
AHEAD = 2
"""If no further cause pays, this many more are added to the best sets: two effects may only pay together."""
LEFT_TOGETHER = 0.05
"""Maximum share of the slow residuals' squares that a set found with `AHEAD` may leave. Three wrong causes
can imitate a part of an effect that the catalogue lacks, but rarely almost all of it."""
SURE_OF_TWO = 1 / 3
"""Two causes may leave more than `LEFT_TOGETHER` if the interval of their gain on unseen data is above this
share."""
ROUNDS, LOWER = 5, 0.75
"""Maximum number of changes of a set that leaves more than noise. Each change must lower χ² to this share or
less."""
ON_BOUND_FACTOR = 1.1
"""Factor for the χ² of a fit that is not `within_bounds`, to compare it with other fits."""
NEW_START_STEPS = 5
"""If a fit starts again from several points: number of steps from each point, before one is chosen."""
IDLE = 1.01
"""A cause is idle if χ² rises by at most this factor without it."""
NO_EFFECT = 1e-3
"""A further cause that changes χ² by a smaller share is dropped: free rig numbers already do the same."""
PROMISING = 4
"""Number of further causes that are fitted: those with the largest expected gain."""
EXCHANGES = 5
"""Number of exchanges of one cause for another that are fitted: those with the lowest expected χ²."""
LEADERS, LEADERS_LEFT = 6, 3
"""Number of fits that are completed: those with the lowest χ² after their first steps. The second value is
used if the fits have several causes and even the best leaves more than noise: then they get a further cause
next."""
REACH, REACH_SHARE = 2000.0, 0.1
"""Assumed maximum by which an unfinished fit can still lower χ²: 2000 + 10 % of the best fit's reduction of
the null model's χ². If the best fit leaves only noise, a fit that needs more than this to win is not
completed."""
OF_RANGE = 1e-3


Progress = Callable[[str, float], None]
"""Called with the current step, and the share of the work that is done."""


def silent(step: str, share: float) -> None:
    """The default: no progress report."""


class Search:
    """The search for one fit problem; `nulls` are the baseline with fixed and with free rig numbers."""

    def __init__(self, problem: FitProblem, catalogue: Sequence[Cause]) -> None:
        self.problem = problem
        self.catalogue = tuple(catalogue)
        self.keys = rig_number_keys(problem.case.rig)
        start = problem.start()
        exact = problem.fit(start)
        moved = problem.fit(exact.point.with_free(self.keys))
        self.nulls = (Candidate(problem, exact), Candidate(problem, moved))
        self.null = min(self.nulls, key=lambda c: c.score)
        self.held_out_errors = HeldOutErrors(problem)

    def _fitted(self, start: FitPoint, max_steps: int = MAX_STEPS) -> Candidate:
        """A fit that is precise enough to be compared with others."""
        return Candidate(self.problem, self.problem.fit(start, max_steps, min_gain=ROUGH_GAIN))

    def _begun(self, base: Candidate, cause: Cause) -> Candidate:
        """The first steps of a fit of the base with a further cause."""
        return Candidate(self.problem, self.problem.first_fit(base.fit.point, cause))

    def _finished(self, pairs: Sequence[tuple[Candidate, Cause]], most: int = LEADERS) -> list[Candidate]:
        """Fits of each base with its further cause, the best first; at most `most` fits are completed.

        If the fits have several causes and the best leaves more than noise, fewer are completed
        (`LEADERS_LEFT`). If the best fit is adequate, only fits close to it are completed.
        """
        if not pairs:
            return []
        first, *others = sorted(mapped(lambda pair: self._begun(*pair), pairs), key=_chi2)
        best = self._fitted(first.fit.point)
        reach = self._reach(best)
        leaders = LEADERS if best.adequate or len(best.causes) == 1 else LEADERS_LEFT
        near = [c for c in others[: min(leaders, most) - 1] if c.fit.chi2 < reach]
        complete = [best, *mapped(lambda c: self._fitted(c.fit.point), near)]
        return sorted([*mapped(self._off_bounds, complete), *others[len(near) :]], key=_chi2)

    def _off_bounds(self, candidate: Candidate) -> Candidate:
        """The candidate, or a better one if one of several causes has a parameter on its bound.

        A parameter that was fitted without the later causes may have moved to its bound. One new start adds
        the causes in reverse order, the others use the seeds of each cause on a bound. Only the fit from the
        best start is completed.
        """
        if len(candidate.causes) < 2 or not candidate.on_bound:
            return candidate
        again = self.nulls[1]
        for cause in reversed(candidate.causes):
            again = self._begun(again, cause)
        starts = [again.fit.point, *_at_other_seeds(candidate.fit.point, candidate.causes_on_bound)]
        begun = [self._fitted(start, NEW_START_STEPS) for start in starts]
        best = self._fitted(min(begun, key=_chi2_within_bounds).fit.point)
        return min(candidate, best, key=_chi2_within_bounds)

    def _reach(self, first: Candidate) -> float:
        """Maximum χ² of an unfinished fit that can still win."""
        if not first.adequate:
            return inf
        return first.fit.chi2 + REACH + REACH_SHARE * (self.null.fit.chi2 - first.fit.chi2)

    def _leaders(self, bases: Sequence[Candidate]) -> list[Candidate]:
        """The best few of these candidates, each `at_nominal_if_as_good`, the best first."""
        reach = self._reach(bases[0]) if bases else inf
        near = [base for base in bases[:FIRSTS] if base.fit.chi2 < reach]
        leaders = mapped(self.at_nominal_if_as_good, near)
        if not leaders:
            return []
        over = min(leaders, key=_chi2).excess
        return sorted(leaders, key=lambda c: (not c.within_bounds, c.score_at(over)))

    def at_nominal_if_as_good(self, candidate: Candidate) -> Candidate:
        """The same causes, with nominal rig numbers if they do not raise the score.

        A candidate that leaves more than noise keeps its rig numbers free.
        """
        if not candidate.adequate:
            return candidate
        exact = self._fitted(candidate.fit.point.with_free(()))
        over = candidate.excess
        return min(exact, candidate, key=lambda c: c.score_at(over))

    def further(self, bases: Sequence[Candidate], most: int | None = None) -> list[Candidate]:
        """Fits of the bases with one more cause, the best first; only the most promising are fitted.

        Args:
            most: fit at most this many, those with the lowest expected χ², and complete only the best fit.
        """
        expected: dict[frozenset[str], float] = {}
        pairs: dict[frozenset[str], tuple[Candidate, Cause]] = {}
        for base, promises in zip(bases, mapped(self._promises, bases), strict=True):
            for cause in sorted(promises, key=lambda cause: -promises[cause])[:PROMISING]:
                names = frozenset((*base.names, cause.name))
                pairs.setdefault(names, (base, cause))
                expected.setdefault(names, base.fit.chi2 - promises[cause])
        first = sorted(pairs, key=expected.__getitem__)[:most]
        found = self._finished([pairs[names] for names in first], LEADERS if most is None else 1)
        before = {names: base.fit.chi2 for names, (base, _) in pairs.items()}
        return [c for c in found if abs(c.fit.chi2 / before[frozenset(c.names)] - 1.0) > NO_EFFECT]

    def _exchanged(self, candidate: Candidate) -> list[Candidate]:
        """Fits of the candidate with one more cause, or with one of its causes replaced by another."""
        more = [candidate] if len(candidate.causes) < MAX_CAUSES else []
        return self.further([*more, *self._with_one_removed(candidate)], EXCHANGES)

    def _may_gain(self, candidate: Candidate) -> bool:
        """True if a further cause may pay.

        This is so if the residuals are more than noise, a parameter is on its bound, or the expected gain of
        a cause is large enough. With a parameter on its bound the expected gain says little, because the
        further cause may move the parameter off its bound.
        """
        if not candidate.adequate or candidate.on_bound:
            return True
        promises = self._promises(candidate)
        return bool(promises) and max(promises.values()) > CLAIM + log(self.problem.readings)

    def _promises(self, base: Candidate) -> dict[Cause, float]:
        """The expected gain of each further cause."""
        tangents = self.problem.tangents(base.fit)
        others = [c for c in self.catalogue if not any(c.excludes(own) for own in base.causes)]
        return {cause: self._promise(base.fit, tangents, cause) for cause in others}

    def _promise(self, base: Fit, tangents: Tangents, cause: Cause) -> float:
        """Expected reduction of χ² by a cause, if its effect is scaled and everything else is refitted."""
        parameter = cause.parameters[0]
        best = 0.0
        for values in cause.seeds():
            seed = parameter.to_search(values[0])
            # A neutral seed has no effect, so a value beside it is also tried.
            for searched in (seed, seed + OF_RANGE * (parameter.to_search(parameter.high) - seed)):
                point = base.point.with_cause(cause, (parameter.to_model(searched), *values[1:]))
                trace = [a - b for a, b in zip(self.problem.residuals(point), base.residuals, strict=True)]
                best = max(best, tangents.gain(trace, parameter.two_sided))
        return best

    def best(self, progress: Progress = silent) -> SearchResult:
        """Run the search."""
        progress("single causes", 0.1)
        bases = self._finished([(self.nulls[1], cause) for cause in self.catalogue])
        leaders = self._leaders(bases)
        return self._grown([*self.nulls, *bases, *leaders], bases[:FIRSTS], leaders, progress)

    def resumed(self, earlier: SearchResult, progress: Progress = silent) -> SearchResult:
        """Continue an earlier search of the same data that assumed another sensor noise."""
        tried = [*self.nulls, *(c.in_units_of(self.problem) for c in earlier.tried if c.causes)]
        chosen = self.at_nominal_if_as_good(self._fitted(earlier.chosen.fit.point.with_free(self.keys)))
        while chosen.causes_on_bound:
            chosen = self._without(chosen, chosen.causes_on_bound[0])
        return self._grown([*tried, chosen], [chosen], [chosen], progress)

    def together(self, earlier: SearchResult, progress: Progress = silent) -> SearchResult:
        """Continue from a result that leaves more than noise: many causes may only pay together.

        The set with the lowest χ² gets a further cause, or one of its causes is replaced by another. This is
        repeated until the set explains everything, or χ² no longer falls to `LOWER`.
        """
        best = self._without_idle(min((c for c in earlier.tried if c.within_bounds), key=_chi2))
        for _ in range(ROUNDS):
            progress("many causes together", 0.8)
            lowest = min((c for c in self._exchanged(best) if c.within_bounds), key=_chi2, default=best)
            if lowest.fit.chi2 > LOWER * best.fit.chi2:
                break
            best = self._without_idle(lowest)
            if best.adequate:
                best = self.at_nominal_if_as_good(best)
                if not self._pays(best, earlier.chosen):
                    break
                return self._grown([*earlier.tried, best], [best], [best], progress)
        return earlier

    def _without_idle(self, candidate: Candidate) -> Candidate:
        """The candidate without causes that hardly lower χ²."""
        fewer = mapped(partial(self._without, candidate), candidate.doubtful())
        lowest = min(fewer, key=_chi2, default=None)
        if lowest is None or lowest.fit.chi2 > IDLE * candidate.fit.chi2:
            return candidate
        return self._without_idle(lowest)

    def _grown(
        self,
        tried: list[Candidate],
        firsts: Sequence[Candidate],
        leaders: Sequence[Candidate],
        progress: Progress,
    ) -> SearchResult:
        """Add causes to the leaders, and exchange them, while that pays."""
        chosen = lowest = self.null
        while True:
            better = self._first_that_pays(leaders, chosen)
            if better is None and len(chosen.causes) > 1 and not chosen.adequate:
                lower = self._reseeded(chosen)
                if lower is not chosen:
                    chosen = lower
                    leaders = self._leaders(self.further([chosen])) if self._may_gain(chosen) else []
                    tried += [chosen, *leaders]
                    continue
                lowest = chosen
            if better is None:
                better, leaders = self._exchanged_or_ahead(chosen, leaders, tried)
            if better is None:
                break
            chosen, fewer = self._pruned(better)
            tried += fewer
            count = len(chosen.causes) + 1
            if count > MAX_CAUSES or not self._may_gain(chosen):
                break
            progress(f"{count} causes together", min(0.75, 0.15 * count))
            firsts = firsts if count == 2 else _distinct([chosen, *leaders])[:BEAM]
            leaders = self._leaders(self.further(firsts))
            tried += leaders
        if len(chosen.causes) > 1 and chosen is not lowest:
            chosen = self._reseeded(chosen)
        chosen = replace(chosen, fit=self.problem.fit(chosen.fit.point))
        several = range(len(chosen.causes)) if len(chosen.causes) > 1 else ()
        without = mapped(partial(self._without, chosen), several)
        return SearchResult(self, [*tried, chosen, *without], chosen, tuple(without))

    def _exchanged_or_ahead(
        self, chosen: Candidate, leaders: Sequence[Candidate], tried: list[Candidate]
    ) -> tuple[Candidate | None, Sequence[Candidate]]:
        """Exchange one cause. If that does not pay, add up to `AHEAD` causes, of which not each has to pay.

        Returns the set that pays, or None, and the leaders.
        """
        better = None
        if len(chosen.causes) > 1:
            exchanged = self._leaders(self.further(self._with_one_removed(chosen)))
            tried += exchanged
            better = self._first_that_pays(exchanged, chosen)
            leaders = sorted([*leaders, *exchanged], key=lambda c: (not c.within_bounds, c.fit.chi2))
        if better is None and not chosen.adequate:
            bases = [*self._with_flow_laws(chosen), *_distinct(leaders)[:BEAM]]
            for _ in range(AHEAD):
                leaders = self._leaders(self.further(bases))
                tried += leaders
                better = self._first_that_pays(filter(self._explains_nearly_all, leaders), chosen)
                if better is not None:
                    break
                bases = _distinct(leaders)[:BEAM]
        return better, leaders

    def _with_flow_laws(self, candidate: Candidate) -> list[Candidate]:
        """The candidate with all flow laws that it lacks; empty if it has them all.

        A law cannot be weak, and it changes every flow. So it may fit worse until other causes are there.
        """
        laws = [cause for cause in self.catalogue if cause.is_flow_law and cause not in candidate.causes]
        if not laws or len(candidate.causes) + len(laws) > MAX_CAUSES:
            return []
        fit = self.problem.at(candidate.fit.point.with_free(self.keys))
        for cause in laws:
            fit = self.problem.first_fit(fit.point, cause)
        return [self._fitted(fit.point)]

    def _explains_nearly_all(self, candidate: Candidate) -> bool:
        """True if little is left of the null model's slow residuals, or if two causes predict much better."""
        left, whole = (sum(c.excess) - 2.0 for c in (candidate, self.null))
        if left <= LEFT_TOGETHER * whole:
            return True
        pair = candidate.within_bounds and len(candidate.causes) == 2
        return pair and self.held_out_errors.gain(self.null.fit.point, candidate.fit.point)[0] > SURE_OF_TWO

    def _first_that_pays(self, leaders: Iterable[Candidate], chosen: Candidate) -> Candidate | None:
        """The best leader that pays in comparison with the chosen candidate; None if none does."""
        return next((leader for leader in leaders if self._pays(leader, chosen)), None)

    def _pays(self, more: Candidate, less: Candidate) -> bool:
        """True if `more` pays in comparison with `less`; if more than noise remains, also on unseen data."""
        if not more.within_bounds:
            return False
        gain = less.score_at(more.excess) - more.score_at(more.excess)
        if more.adequate:
            claim = CLAIM_ON_BOUND if less.on_bound and not more.on_bound else CLAIM
            return gain > (claim if len(more.causes) > len(less.causes) else 0.0)
        return gain > CLAIM_LEFT and self.held_out_errors.gain(less.fit.point, more.fit.point)[0] > MIN_GAIN

    def _pruned(self, candidate: Candidate) -> tuple[Candidate, list[Candidate]]:
        """The candidate without causes that no longer pay, and all candidates that were tried."""
        tried: list[Candidate] = []
        while len(candidate.causes) > 1 and (doubtful := candidate.doubtful()):
            fewer = mapped(partial(self._without, candidate), doubtful)
            tried += fewer
            over, claim = candidate.excess, CLAIM if candidate.adequate else CLAIM_LEFT
            allowed = candidate.score_at(over) + claim
            fewer = [c for c in fewer if c.within_bounds and (candidate.on_bound or not c.on_bound)]
            as_good = [c for c in fewer if c.score_at(over) <= allowed]
            if not as_good:
                break
            candidate = min(as_good, key=lambda c: c.score_at(over))
        return candidate, tried

    def _reseeded(self, candidate: Candidate) -> Candidate:
        """The candidate at its lowest minimum: each cause starts again from its other seeds.

        A seed was chosen when other causes were still missing.
        """
        starts = _at_other_seeds(candidate.fit.point, range(len(candidate.causes)))
        best = min(mapped(self._fitted, starts), key=lambda c: c.fit.cost, default=candidate)
        gained = candidate.fit.cost - best.fit.cost
        if gained < max(1.0, candidate.fit.cost / self.problem.readings):
            return candidate
        return self.at_nominal_if_as_good(best)

    def _with_one_removed(self, candidate: Candidate) -> list[Candidate]:
        """The candidate without each of its causes in turn, not refitted, to add another cause instead."""
        point = candidate.fit.point.with_free(self.keys)
        every = range(len(candidate.causes))
        return [Candidate(self.problem, self.problem.at(point.without(index))) for index in every]

    def _without(self, candidate: Candidate, index: int) -> Candidate:
        """The candidate refitted without one of its causes."""
        point = candidate.fit.point.with_free(self.keys).without(index)
        return self.at_nominal_if_as_good(self._fitted(point))


def _at_other_seeds(point: FitPoint, indices: Iterable[int]) -> list[FitPoint]:
    """The point with each seed of each of these causes; a cause with many seeds is left out."""
    return [
        point.with_values(index, seed)
        for index in indices
        if len(point.causes[index].seeds()) <= MAX_SEEDS
        for seed in point.causes[index].seeds()
    ]


def _chi2(candidate: Candidate) -> float:
    return candidate.fit.chi2


def _chi2_within_bounds(candidate: Candidate) -> float:
    """χ², multiplied by `ON_BOUND_FACTOR` if a cause has a parameter on a bound."""
    return candidate.fit.chi2 * (1.0 if candidate.within_bounds else ON_BOUND_FACTOR)


def _distinct(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The first candidate of each set of causes. All laws of a thing, such as a leak, count as one cause."""
    first: dict[frozenset[str], Candidate] = {}
    for candidate in candidates:
        first.setdefault(frozenset(cause.law_of or cause.name for cause in candidate.causes), candidate)
    return list(first.values())


@dataclass(frozen=True)
class SearchResult:
    """Everything that was tried, and the candidate that explains the data best."""

    search: Search
    tried: list[Candidate]
    chosen: Candidate
    without: tuple[Candidate, ...]
    """The chosen candidate without each of its causes in turn; empty if it has none or one."""

    def score(self, candidate: Candidate) -> float:
        """The score, with χ² divided by the chosen candidate's excess over noise."""
        return candidate.score_at(self.chosen.excess)
