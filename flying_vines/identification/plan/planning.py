"""Which runs to record: a plan for a believed rig, and the single run that settles a doubt."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from flying_vines.identification.plan.apart import SETTLED, apart
from flying_vines.identification.plan.check import Check
from flying_vines.identification.plan.choose import RecordingBudget, choose, gram_of
from flying_vines.identification.plan.library import FULL_KPA, LOW_KPA, MOST_KPA, CandidateRun, library
from flying_vines.identification.plan.traces import CandidatePart, Layout, layout_of, parts_of
from flying_vines.identification.search import Progress, silent
from flying_vines.identification.verdict import NONE
from flying_vines.physics.arrays import Array
from flying_vines.physics.constants import ALPHA_KPA
from flying_vines.physics.effects import catalogue
from flying_vines.physics.rig import Rig
from flying_vines.simulation.scenario.kinds import RunKind
from flying_vines.simulation.scenario.scenario import Scenario

MINUTES = 3.0
SPENT_KPA = 100.0
"""Of the reservoir: what is left in a bottle that has no air for a run any more."""
SCENARIO = "Runs that tell causes apart"
LONGEST_S = 60.0
"""Of a run that settles a doubt."""
_LOOK_AGAIN = 2.0 * SETTLED
"""Below it a full fit takes the place of the floor."""


class RecordingPlanError(ValueError):
    """A plan that cannot be made; its text is one line."""


class CausePair(NamedTuple):
    """Two causes, or a cause and `none`."""

    first: str
    second: str


class PairSeparation(NamedTuple):
    """By how many standard deviations a pair is told apart: with all runs but one, and with that as well."""

    pair: CausePair
    without: float
    having: float


@dataclass(frozen=True)
class PlannedRun:
    """A run of a plan."""

    name: str
    shows: str
    kind: RunKind
    """As it stands in a scenario."""
    seconds: float
    air_SL: float
    commanded: bool
    """Whether the service can do it: it consists of pressure commands alone."""
    told: tuple[PairSeparation, ...]
    """The pairs that nothing else of the plan settles; where there is none, the one that it makes surest."""

    def as_json(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "shows": self.shows,
            "reservoir_kPa": self.kind.reservoir_kPa,
            "seconds": round(self.seconds, 3),
            "air_SL": round(self.air_SL, 4),
            "commanded": self.commanded,
            "told": [
                {"pair": [*told.pair], "sigmas_without": told.without, "sigmas_with": told.having}
                for told in self.told
            ],
        }


@dataclass(frozen=True)
class Recording:
    """Some runs, and what they leave open."""

    runs: tuple[PlannedRun, ...]
    air_SL: float
    open: tuple[CausePair, ...]
    """Δχ² below `SETTLED`, whichever of the two is there; with `none`: the cause does not show."""

    @property
    def seconds(self) -> float:
        return sum(run.seconds for run in self.runs)

    @property
    def scenario(self) -> Scenario:
        """As `flying_vines.simulation.scenario` takes it."""
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
    """Which runs of a rig to record within a time and an air budget, and what they will tell apart."""

    rig: Rig
    minutes: float
    air_SL: float
    """The budgets."""
    best: Recording
    by_commands: Recording
    """What the service can do: `best` where that settles as much."""
    names: tuple[str, ...]
    """Of the causes: the rows of the matrix, and its columns but for the last, which is `none`."""
    matrix: Array
    """(causes, causes + 1) Δχ² in `best`: the row is there at its typical strength, the column is fitted."""
    never: tuple[CausePair, ...]
    """Open in `best`, and in all runs of the library together."""

    @property
    def sigmas(self) -> Array:
        """The matrix in standard deviations."""
        roots: Array = np.sqrt(self.matrix)
        return roots

    def as_json(self) -> dict[str, Any]:
        """For machines; the matrix in Δχ²."""
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
    """The run that best tells some causes apart."""

    run: PlannedRun
    sigmas: float
    """Of the pair that it tells apart worst."""
    worst: CausePair

    def in_words(self) -> str:
        """A sentence or two for people."""
        run, (first, second) = self.run, self.worst
        if self.sigmas < 1.0:
            return f"No run of the library tells {first} from {second}."
        what = f"{run.name} for {run.seconds:.0f} s from {run.kind.reservoir_kPa:g} kPa ({run.shows})"
        told = f"Record {what}: it tells {first} from {second} by {self.sigmas:.0f} standard deviations."
        return told if self.sigmas**2 >= SETTLED else f"{told} No run of the library settles it."


def plan(
    rig: Rig,
    minutes: float = MINUTES,
    air_SL: float | None = None,
    most_kPa: float = MOST_KPA,
    progress: Progress = silent,
) -> RecordingPlan:
    """Which runs to record of a rig.

    Args:
        rig: as it is believed to be.
        minutes: of recording, without what lies between the runs.
        air_SL: from the reservoir; unless given, what it holds between 690 and 100 kPa.
        most_kPa: to which the control volume may be inflated, gauge.
        progress: is told what is being done.

    Raises PlanError when no run fits.
    """
    if air_SL is None:
        air_SL = rig.reservoir.volume_L * (FULL_KPA - SPENT_KPA) / ALPHA_KPA
    for what, value in (("minutes", minutes), ("air_SL", air_SL), ("most_kPa", most_kPa)):
        if not value > 0.0 or not np.isfinite(value):
            raise RecordingPlanError(f"{what}: {value:g} is not above 0")
    if most_kPa > 0.5 * LOW_KPA:
        raise RecordingPlanError(
            f"most_kPa: {most_kPa:g} is too near the {LOW_KPA:g} kPa from which runs fill it"
        )
    with threadpool_limits(1):
        layout = layout_of(rig, catalogue())
        parts = _all_parts(layout, library(rig, most_kPa), progress)
        budget = RecordingBudget(layout, 60.0 * minutes, air_SL)
        progress("choosing", 0.6)
        by_commands = _look(layout, choose(layout, [p for p in parts if p.candidate.commanded], budget))
        best = by_commands
        if by_commands.open:
            anything = _look(layout, choose(layout, parts, budget))
            if len(anything.open) < len(by_commands.open):
                best = anything
        if not best.parts:
            raise RecordingPlanError(
                f"no run fits into {60.0 * minutes:g} s and {air_SL:g} standard litres; allow more of either"
            )
        progress("what no run would tell", 0.9)
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


def recommend(rig: Rig, doubt: Collection[str], most_kPa: float = MOST_KPA) -> Recommendation:
    """The run of at most a minute that tells these causes (`none` may be among them) apart best.

    One that the service can do is preferred where it settles them. Raises PlanError for names that are not in
    the catalogue, or fewer than two.
    """
    known = {cause.name: cause for cause in catalogue()}
    unknown = sorted(set(doubt) - {*known, NONE})
    if unknown or len(set(doubt)) < 2:
        raise RecordingPlanError(f"no two causes to tell apart: {', '.join(unknown or sorted(set(doubt)))}")
    causes = [cause for name, cause in known.items() if name in doubt]
    with_none = NONE in doubt
    with threadpool_limits(1):
        layout = layout_of(rig, causes)
        parts = [p for p in _all_parts(layout, library(rig, most_kPa), silent) if p.seconds <= LONGEST_S]
        looks = [(part, *_worst(layout, apart(layout, part.gram), with_none)) for part in parts]
        if max(look[2] for look in looks) < SETTLED:
            # Floors: before it is said that nothing settles it, full fits.
            looks = [
                (part, *_worst(layout, _look(layout, [part]).matrix, with_none)) for part in _longest(parts)
            ]
    commanded = [look for look in looks if look[0].candidate.commanded and look[2] >= SETTLED]
    part, pair, least = max(commanded or looks, key=lambda look: look[2])
    return Recommendation(_planned(part), sqrt(least), pair)


class _Look(NamedTuple):
    """Some runs, looked at."""

    parts: list[CandidatePart]
    matrix: Array
    open: tuple[CausePair, ...]


def _all_parts(layout: Layout, candidates: Sequence[CandidateRun], progress: Progress) -> list[CandidatePart]:
    parts: list[CandidatePart] = []
    for done, candidate in enumerate(candidates):
        progress(f"trying {candidate.name}", 0.6 * done / len(candidates))
        parts += parts_of(layout, candidate)
    return parts


def _longest(parts: Sequence[CandidatePart]) -> list[CandidatePart]:
    """Of each candidate."""
    return list({part.candidate.name: part for part in parts}.values())


def _look(layout: Layout, parts: list[CandidatePart]) -> _Look:
    """The matrix, with full fits in place of floors where those are low, and what is open."""
    matrix = apart(layout, gram_of(layout, parts))
    none = len(layout.causes)
    if parts:
        check = Check(layout, parts)
        for there, row in enumerate(matrix):
            # None first: a cause that does not show is not to be told from anything.
            for fitted in (none, *range(none)):
                if fitted != there and row[fitted] < _LOOK_AGAIN:
                    row[fitted] = check.apart(there, fitted)
                if row[none] < SETTLED:
                    break
    return _Look(parts, matrix, _open(layout, matrix))


def _open(layout: Layout, matrix: Array) -> tuple[CausePair, ...]:
    """Pairs below `SETTLED`; of a cause that does not show only that."""
    names, none = layout.names, len(layout.names)
    shown = [index for index in range(none) if matrix[index, none] >= SETTLED]
    pairs = [CausePair(name, NONE) for index, name in enumerate(names) if index not in shown]
    for a, b in combinations(shown, 2):
        if min(matrix[a, b], matrix[b, a]) < SETTLED:
            pairs.append(CausePair(names[a], names[b]))
    return tuple(pairs)


def _open_in_all(
    layout: Layout, parts: Sequence[CandidatePart], pairs: Sequence[CausePair]
) -> tuple[CausePair, ...]:
    """Of some pairs those that all runs together, each at its longest, leave open."""
    whole = _longest(parts)
    floors, check = apart(layout, gram_of(layout, whole)), Check(layout, whole)
    columns = (*layout.names, NONE)

    def is_open(there: str, fitted: str) -> bool:
        at = columns.index(there), columns.index(fitted)
        return floors[at] < SETTLED and check.apart(*at) < SETTLED

    return tuple(
        pair for pair in pairs if is_open(*pair) or (pair.second != NONE and is_open(pair.second, pair.first))
    )


def _recording(layout: Layout, budget: RecordingBudget, look: _Look) -> Recording:
    runs = []
    for index, part in enumerate(look.parts):
        without = apart(layout, gram_of(layout, [*look.parts[:index], *look.parts[index + 1 :]]))
        opened = [pair for pair in _open(layout, without) if pair not in look.open]
        pairs = opened or [_sharpened(layout, look.matrix, without)]
        told = [
            PairSeparation(
                pair, *(round(_sigmas(layout, matrix, pair), 2) for matrix in (without, look.matrix))
            )
            for pair in pairs
        ]
        runs.append(_planned(part, sorted(told, key=lambda t: t.without)))
    return Recording(tuple(runs), budget.air_SL(look.parts), look.open)


def _sigmas(layout: Layout, matrix: Array, pair: CausePair) -> float:
    """Whichever of the two is there."""
    there = layout.names.index(pair.first)
    if pair.second == NONE:
        return sqrt(matrix[there, -1])
    other = layout.names.index(pair.second)
    return sqrt(min(matrix[there, other], matrix[other, there]))


def _sharpened(layout: Layout, matrix: Array, without: Array) -> CausePair:
    """The pair for which a run does most, least sure pairs first."""
    gain = np.log((matrix + 1.0) / (without + 1.0)) / np.sqrt(without + SETTLED)
    np.fill_diagonal(gain, -np.inf)
    there, fitted = np.unravel_index(int(np.argmax(gain)), gain.shape)
    return CausePair(layout.names[there], (*layout.names, NONE)[fitted])


def _planned(part: CandidatePart, told: Sequence[PairSeparation] = ()) -> PlannedRun:
    candidate = part.candidate
    return PlannedRun(
        name=candidate.name,
        shows=candidate.shows,
        kind=part.kind,
        seconds=part.seconds,
        air_SL=part.air_SL,
        commanded=candidate.commanded,
        told=tuple(told),
    )


def _worst(layout: Layout, matrix: Array, with_none: bool) -> tuple[CausePair, float]:
    """The pair that is told apart worst, and its Δχ²."""
    columns = (*layout.names, NONE) if with_none else layout.names
    among = matrix[:, : len(columns)].copy()
    np.fill_diagonal(among, np.inf)
    there, fitted = np.unravel_index(int(np.argmin(among)), among.shape)
    return CausePair(layout.names[there], columns[fitted]), float(among[there, fitted])
