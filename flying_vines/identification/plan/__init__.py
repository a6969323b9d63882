"""Plans which runs to record: those that best separate the causes of a discrepancy.

made = plan(load_rig("rig.toml"), minutes=3.0)      the runs, and the causes that they separate
made.best.scenario                                  for `flying_vines.simulation.scenario`
recommend(rig, causes)                              the runs that separate these causes
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import inf, sqrt
from typing import Any, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from flying_vines.identification.noise import Noise
from flying_vines.identification.plan.choose import (
    SETTLED,
    FullFits,
    RecordingBudget,
    cause_distances,
    choose,
    gram_of,
)
from flying_vines.identification.plan.library import (
    FULL_KPA,
    LOW_KPA,
    MAX_KPA,
    OUTLETS,
    CandidateRun,
    library,
)
from flying_vines.identification.plan.traces import NO_VALUES, CandidatePart, Layout, layout_of, parts_of
from flying_vines.identification.search import Progress, silent
from flying_vines.identification.verdict import NONE
from flying_vines.physics.arrays import Array
from flying_vines.physics.cause import Cause, Values
from flying_vines.physics.effects import causes_of
from flying_vines.physics.gas import ALPHA_KPA
from flying_vines.physics.rig import Rig
from flying_vines.simulation.scenario.scenario import RunKind, Scenario

MINUTES = 3.0
SPENT_KPA = 100.0
"""Reservoir pressure (gauge) below which there is no air for another run."""
SCENARIO = "Runs that separate causes"
MAX_S = 60.0
"""Maximum length of a recommended run."""
MAX_RUNS = 3
MIN_FALL = 0.2
"""A further run is recommended if it reduces the number of open pairs (`_left`) by at least this."""
_FULL_FIT = 2.0 * SETTLED
"""Below this Δχ² a full fit replaces the lower bound from the traces."""


class RecordingPlanError(ValueError):
    """A plan cannot be made; the text is one line."""


class CausePair(NamedTuple):
    """Two causes, or a cause and `none`."""

    first: str
    second: str


class PairSeparation(NamedTuple):
    """Separation of a pair in standard deviations: without one run, and with all runs."""

    pair: CausePair
    without: float
    with_all: float


@dataclass(frozen=True)
class PlannedRun:
    """A run of a plan."""

    name: str
    shows: str
    kind: RunKind
    """The run in a scenario."""
    seconds: float
    air_SL: float
    commanded: bool
    """True if the service can do it: it consists of pressure commands only."""
    separations: tuple[PairSeparation, ...]
    """Pairs that only this run separates; if there are none, the pair that it improves most."""

    def as_json(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "shows": self.shows,
            "reservoir_kPa": self.kind.reservoir_kPa,
            "seconds": round(self.seconds, 3),
            "air_SL": round(self.air_SL, 4),
            "commanded": self.commanded,
            "told": [
                {"pair": [*found.pair], "sigmas_without": found.without, "sigmas_with": found.with_all}
                for found in self.separations
            ],
        }


@dataclass(frozen=True)
class Recording:
    """Some runs, and the pairs that they do not separate."""

    runs: tuple[PlannedRun, ...]
    air_SL: float
    open: tuple[CausePair, ...]
    """Pairs with Δχ² below `SETTLED` in either direction; a pair with `none`: the cause does not show."""

    @property
    def seconds(self) -> float:
        return sum(run.seconds for run in self.runs)

    @property
    def scenario(self) -> Scenario:
        """The runs for `flying_vines.simulation.scenario`."""
        return Scenario(name=SCENARIO, runs=tuple(run.kind for run in self.runs))

    def as_json(self) -> dict[str, Any]:
        return {
            "seconds": round(self.seconds, 3),
            "air_SL": round(self.air_SL, 4),
            "runs": [run.as_json() for run in self.runs],
            "open": [[*pair] for pair in self.open],
        }


@dataclass(frozen=True, eq=False)
class RecordingPlan:
    """The runs of a rig to record within limits of time and air, and the causes that they separate."""

    rig: Rig
    minutes: float
    """Limit of the recording time."""
    air_SL: float
    """Limit of the air."""
    best: Recording
    by_commands: Recording
    """The best plan that the service can do; it is `best` if no other plan leaves fewer pairs open."""
    names: tuple[str, ...]
    """The causes of the matrix's rows and columns; the last column of the matrix is the baseline, `none`."""
    matrix: Array
    """(causes, causes + 1) Δχ² in `best`: the row is in the rig at typical strength, the column is fitted."""
    never: tuple[CausePair, ...]
    """Pairs that neither `best` nor all runs of the library together separate."""

    @property
    def sigmas(self) -> Array:
        """The matrix in standard deviations."""
        roots: Array = np.sqrt(self.matrix)
        return roots

    def as_json(self) -> dict[str, Any]:
        """The plan as JSON; the matrix in Δχ²."""
        return {
            "minutes": self.minutes,
            "air_SL": self.air_SL,
            "best": self.best.as_json(),
            "by_commands": self.by_commands.as_json(),
            "never": [[*pair] for pair in self.never],
            "there": [*self.names],
            "fitted": [*self.names, NONE],
            "matrix": [[round(value, 2) for value in row] for row in self.matrix.tolist()],
        }


@dataclass(frozen=True)
class Recommendation:
    """The runs that best separate some causes."""

    rig: Rig
    runs: tuple[PlannedRun, ...]
    pairs: tuple[tuple[CausePair, float], ...]
    """Each pair with its separation in standard deviations, the lowest first."""

    @property
    def scenario(self) -> Scenario:
        """The runs for `flying_vines.simulation.scenario`."""
        return Scenario(name=SCENARIO, runs=tuple(run.kind for run in self.runs))

    @property
    def any_separated(self) -> bool:
        """True if the runs separate at least one pair by one standard deviation or more."""
        return any(sigmas >= 1.0 for _, sigmas in self.pairs)

    def in_words(self) -> str:
        """One or two sentences for people."""
        sure = [(pair, sigmas) for pair, sigmas in self.pairs if sigmas**2 >= SETTLED]
        near = [(pair, sigmas) for pair, sigmas in self.pairs if sigmas >= 1.0 and sigmas**2 < SETTLED]
        left = [pair for pair, sigmas in self.pairs if sigmas**2 < SETTLED]
        if not self.any_separated:
            return f"No run of the library separates {_from_each_other(left)}."
        what = ", then ".join(map(self._run_in_words, self.runs))
        it = "it separates" if len(self.runs) == 1 else "they separate"
        shown = sure or near
        by = f"{'at least ' if len(shown) > 1 else ''}{shown[0][1]:.0f} standard deviations"
        advice = f"Record {what}: {it} {_from_each_other([pair for pair, _ in shown])} by {by}."
        return (
            f"{advice} No run of the library surely separates {_from_each_other(left)}." if left else advice
        )

    def _run_in_words(self, run: PlannedRun) -> str:
        supply = "" if self.rig.pump else f" from {run.kind.reservoir_kPa:.3g} kPa"
        return f"{run.name} for {run.seconds:.0f} s{supply} ({run.shows})"


def _from_each_other(pairs: Sequence[CausePair]) -> str:
    """`a from b and c; d from e`."""
    left, texts = list(pairs), []
    while left:
        often = Counter(name for pair in left for name in pair)
        ((name, _),) = often.most_common(1)
        others = [second if first == name else first for first, second in left if name in (first, second)]
        texts.append(f"{name} from {_listed(others)}")
        left = [pair for pair in left if name not in pair]
    return "; ".join(texts)


def _listed(names: Sequence[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def plan(
    rig: Rig,
    minutes: float = MINUTES,
    air_SL: float | None = None,
    most_kPa: float = MAX_KPA,
    progress: Progress = silent,
) -> RecordingPlan:
    """Choose the runs to record on a rig.

    Args:
        rig: the nominal rig.
        minutes: maximum recording time, without pauses between the runs.
        air_SL: maximum air from the reservoir; default: its content between 690 and 100 kPa gauge.
        most_kPa: maximum pressure of the control volume, gauge.
        progress: called with the current step, and the share of the work that is done.

    Raises RecordingPlanError if no run fits.
    """
    if air_SL is None:
        air_SL = rig.reservoir.volume_L * (FULL_KPA - SPENT_KPA) / ALPHA_KPA
    if rig.pump is not None:
        raise RecordingPlanError("the rig has a pump; a plan needs a reservoir and valves")
    for what, value in (("minutes", minutes), ("air_SL", air_SL), ("most_kPa", most_kPa)):
        if not value > 0.0 or not np.isfinite(value):
            raise RecordingPlanError(f"{what}: {value:g} must be above 0")
    if most_kPa > 0.5 * LOW_KPA:
        raise RecordingPlanError(
            f"most_kPa: {most_kPa:g} must be at most {0.5 * LOW_KPA:g}; some runs fill from {LOW_KPA:g} kPa"
        )
    with threadpool_limits(1):
        layout = layout_of(rig, causes_of(rig))
        parts = _all_parts(layout, library(rig, most_kPa), max(60.0 * minutes, MAX_S), progress)
        budget = RecordingBudget(layout, 60.0 * minutes, air_SL)
        progress("choosing", 0.6)
        by_commands = _evaluated(layout, choose(layout, [p for p in parts if p.candidate.commanded], budget))
        best = by_commands
        if by_commands.open:
            anything = _evaluated(layout, choose(layout, parts, budget))
            if len(anything.open) < len(by_commands.open):
                best = anything
        if not best.parts:
            raise RecordingPlanError(
                f"no run fits into {60.0 * minutes:g} s and {air_SL:g} standard litres; allow more of either"
            )
        progress("pairs that no run separates", 0.9)
        never = _open_in_all(layout, parts, best.open)
        return RecordingPlan(
            rig=rig,
            minutes=minutes,
            air_SL=air_SL,
            best=_recording(layout, budget, best),
            by_commands=_recording(layout, budget, by_commands),
            names=layout.names,
            matrix=best.matrix,
            never=never,
        )


def recommend(
    rig: Rig,
    doubt: Sequence[Cause],
    known: Sequence[tuple[Cause, Values]] = (),
    fitted: Mapping[str, Values] = NO_VALUES,
    noise: Noise | None = None,
    *,
    most_kPa: float = MAX_KPA,
    full_kPa: float = FULL_KPA,
    max_s: float = MAX_S,
    outlets: Collection[str] = OUTLETS,
) -> Recommendation:
    """The runs that best separate these causes from each other. One of the causes may be `none`.

    Runs that the service can do are preferred if they separate the causes. A further run is only recommended
    if it separates more.

    Args:
        known, fitted, noise: see `layout_of`.
        most_kPa, full_kPa, outlets: see `library`.
        max_s: maximum length of one run.

    Raises RecordingPlanError for fewer than two causes, or if the rig can do no run.
    """
    causes = [cause for cause in doubt if cause.name != NONE]
    with_none = len(causes) < len(doubt)
    if len(doubt) < 2 or not causes:
        raise RecordingPlanError(
            f"give at least two causes to separate, not: {', '.join(c.name for c in doubt)}"
        )
    with threadpool_limits(1):
        layout = layout_of(rig, causes, known, fitted, noise)
        parts = _all_parts(layout, library(rig, most_kPa, full_kPa, max_s, outlets), max_s, silent)
        if not parts:
            raise RecordingPlanError(f"no run of the library fits into {max_s:g} s")
        commanded = [part for part in parts if part.candidate.commanded]
        chosen = _separating(layout, commanded, with_none)
        pairs = _pairs(layout, cause_distances(layout, gram_of(layout, chosen)), with_none)
        if pairs[0][1] < SETTLED:
            chosen = _separating(layout, parts, with_none)
            # The traces give lower bounds: full fits may still separate the causes.
            pairs = _pairs(layout, _evaluated(layout, chosen).matrix, with_none)
    return Recommendation(
        rig, tuple(map(_planned, chosen)), tuple((pair, sqrt(separation)) for pair, separation in pairs)
    )


class _Evaluation(NamedTuple):
    """Some runs, their matrix, and the pairs that they leave open."""

    parts: list[CandidatePart]
    matrix: Array
    open: tuple[CausePair, ...]


def _all_parts(
    layout: Layout, candidates: Sequence[CandidateRun], max_s: float, progress: Progress
) -> list[CandidatePart]:
    parts: list[CandidatePart] = []
    for done, candidate in enumerate(candidates):
        progress(f"trying {candidate.name}", 0.6 * done / len(candidates))
        parts += parts_of(layout, candidate, max_s)
    return parts


def _evaluated(layout: Layout, parts: list[CandidatePart]) -> _Evaluation:
    """Evaluate some runs; full fits replace lower bounds below `_FULL_FIT`."""
    matrix = cause_distances(layout, gram_of(layout, parts))
    none = len(layout.causes)
    if parts:
        check = FullFits(layout, parts)
        for there, row in enumerate(matrix):
            # `none` first: a cause that does not show cannot be separated from any other.
            for fitted in (none, *range(none)):
                if fitted != there and row[fitted] < _FULL_FIT:
                    row[fitted] = check.distance(there, fitted)
                if row[none] < SETTLED:
                    break
    return _Evaluation(parts, matrix, _open(layout, matrix))


def _open(layout: Layout, matrix: Array) -> tuple[CausePair, ...]:
    """Pairs below `SETTLED`; a cause that does not show is only paired with `none`."""
    open_ = [pair for pair, found in _separations(layout, matrix).items() if found < SETTLED]
    hidden = {pair.first for pair in open_ if pair.second == NONE}
    return tuple(pair for pair in open_ if pair.second == NONE or hidden.isdisjoint(pair))


def _open_in_all(
    layout: Layout, parts: Sequence[CandidatePart], pairs: Sequence[CausePair]
) -> tuple[CausePair, ...]:
    """The pairs that stay open even with all runs, each at its longest."""
    whole = list({part.candidate.name: part for part in parts}.values())
    bounds, check = cause_distances(layout, gram_of(layout, whole)), FullFits(layout, whole)
    columns = (*layout.names, NONE)

    def is_open(there: str, fitted: str) -> bool:
        at = columns.index(there), columns.index(fitted)
        return bounds[at] < SETTLED and check.distance(*at) < SETTLED

    return tuple(
        pair for pair in pairs if is_open(*pair) or (pair.second != NONE and is_open(pair.second, pair.first))
    )


def _recording(layout: Layout, budget: RecordingBudget, evaluation: _Evaluation) -> Recording:
    runs = []
    for index, part in enumerate(evaluation.parts):
        others = [*evaluation.parts[:index], *evaluation.parts[index + 1 :]]
        without = cause_distances(layout, gram_of(layout, others))
        opened = [pair for pair in _open(layout, without) if pair not in evaluation.open]
        before, after = _separations(layout, without), _separations(layout, evaluation.matrix)
        found = []
        for pair in opened or [_sharpened(layout, evaluation.matrix, without)]:
            known = pair if pair in before else CausePair(pair.second, pair.first)
            found.append(PairSeparation(pair, round(sqrt(before[known]), 2), round(sqrt(after[known]), 2)))
        runs.append(_planned(part, sorted(found, key=lambda one: one.without)))
    return Recording(tuple(runs), budget.air_SL(evaluation.parts), evaluation.open)


def _sharpened(layout: Layout, matrix: Array, without: Array) -> CausePair:
    """The pair that a run improves most; pairs with a low separation weigh more."""
    gain = np.log((matrix + 1.0) / (without + 1.0)) / np.sqrt(without + SETTLED)
    np.fill_diagonal(gain, -np.inf)
    there, fitted = np.unravel_index(int(np.argmax(gain)), gain.shape)
    return CausePair(layout.names[there], (*layout.names, NONE)[fitted])


def _planned(part: CandidatePart, separations: Sequence[PairSeparation] = ()) -> PlannedRun:
    candidate = part.candidate
    return PlannedRun(
        name=candidate.name,
        shows=candidate.shows,
        kind=part.kind,
        seconds=part.seconds,
        air_SL=part.air_SL,
        commanded=candidate.commanded,
        separations=tuple(separations),
    )


def _separating(layout: Layout, parts: Sequence[CandidatePart], with_none: bool) -> list[CandidatePart]:
    """The run that leaves the fewest pairs open, and further runs while that number falls."""
    chosen: list[CandidatePart] = []
    lowest = inf
    while parts and len(chosen) < MAX_RUNS:
        more = [[*chosen, part] for part in parts if part not in chosen]
        left = [
            _left(_pairs(layout, cause_distances(layout, gram_of(layout, runs)), with_none)) for runs in more
        ]
        if not left or min(left) > lowest - MIN_FALL:
            break
        lowest = min(left)
        chosen = more[left.index(lowest)]
    return chosen


def _left(pairs: Sequence[tuple[CausePair, float]]) -> float:
    """Approximate number of pairs that are not separated; see `open_pairs`."""
    return sum(1.0 / (1.0 + separation / SETTLED) for _, separation in pairs)


def _separations(layout: Layout, matrix: Array) -> dict[CausePair, float]:
    """Δχ² of each pair in its worse direction; those with `none` come first."""
    names = layout.names
    found = {CausePair(name, NONE): float(matrix[i, -1]) for i, name in enumerate(names)}
    for a, b in combinations(range(len(names)), 2):
        found[CausePair(names[a], names[b])] = float(min(matrix[a, b], matrix[b, a]))
    return found


def _pairs(layout: Layout, matrix: Array, with_none: bool) -> list[tuple[CausePair, float]]:
    """Each pair with its Δχ², the lowest first."""
    found = _separations(layout, matrix).items()
    return sorted((one for one in found if with_none or one[0].second != NONE), key=lambda one: one[1])
