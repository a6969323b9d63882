"""Distance of two causes on the runs of a plan, and the choice of runs by it, within limits of time and air.

The distance is the χ² that remains if the wrong cause is fitted. Cause A is in the rig at its typical
strength. Cause B is fitted to the noiseless readings: its strength, the rig numbers within their tolerances,
and the initial pressures. The remaining Δχ² is the evidence for A; its square root is the distance in
standard deviations. It can be computed from traces (`traces`) instead of
simulations: from A's trace a, the polyline b through B's traces, and the best change ν of the rig numbers,

    Δχ² = min |a − b − Nν|² + |ν|²   within   |νᵢ| ≤ √3    (ν in standard deviations of a uniform prior)

For any w ≥ 0 the unbounded minimum of |a − b − Nν|² + |ν|² + w Σ(νᵢ² − 3) is a lower bound of Δχ², and
follows from a linear equation. The code uses the maximum of these bounds over a few w. `FullFits` checks it.

Runs are added one by one. Each time, the run with the largest gain for its use of the scarcer limit (time or
air) is added. Then runs are exchanged while that improves the plan. The gain is the reduction of
`open_pairs`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from flying_vines.identification.case import Case
from flying_vines.identification.fit import FitProblem
from flying_vines.identification.plan.library import nominal_run
from flying_vines.identification.plan.traces import CandidatePart, Layout
from flying_vines.identification.simulate import Simulation
from flying_vines.physics.arrays import Array
from flying_vines.physics.gas import ALPHA_KPA

SETTLED = 25.0
"""Δχ² from which two causes count as separated: five standard deviations, as for a claim of the diagnosis."""
_WEIGHTS = (0.0, 10.0, 100.0, 1000.0)
_BOUND = 3.0
MIN_GAIN = 0.03
"""A run that reduces `open_pairs` by less is not added."""
_MAX_EXCHANGES = 20
_ROUNDING = 1e-6


class _Products(NamedTuple):
    """Inner products of traces, without the part that the rig numbers can imitate."""

    own: Array
    """(traces,) each with itself."""
    cross: Array
    """(causes, traces) each trace of typical strength with every trace."""
    following: Array
    """(traces - 1,) each with the next one."""
    slack: float
    """Subtracted from distances: 3 w for each rig number."""


def cause_distances(layout: Layout, gram: Array) -> Array:
    """(causes, causes + 1) Δχ² between the cause in the rig (row) and the fitted one; last column: `none`."""
    left = np.full((len(layout.causes), layout.traces), -np.inf)
    alone = np.zeros(len(layout.causes))
    for products in _weighted(layout, gram):
        left = np.maximum(left, _distances(layout, products))
        alone = np.maximum(alone, products.own[layout.usual] - products.slack)
    found = np.minimum.reduceat(np.maximum(left, 0.0), layout.first, axis=1)
    return np.column_stack((found, alone))


def nearest(layout: Layout, gram: Array, there: int, fitted: int) -> float:
    """The value of the first parameter of `fitted` at which this cause is most similar to `there`."""
    values, first = layout.values[fitted], layout.first[fitted]
    rows = slice(first, first + len(values))
    distance = np.full(len(values), -np.inf)
    for own, cross, _, slack in _weighted(layout, gram):
        distance = np.maximum(
            distance, own[rows] - 2.0 * cross[there, rows] + own[layout.usual[there]] - slack
        )
    # A fit that starts where the cause has no effect would not move.
    idle = [value == layout.causes[fitted].parameters[0].neutral for value in values]
    return values[int(np.argmin(np.where(idle, np.inf, distance)))]


def open_pairs(found: Array) -> float:
    """Approximate number of pairs that are not separated.

    A pair counts 1 / (1 + Δχ² / SETTLED): 1 if nothing separates it, ½ at `SETTLED`.
    """
    others = ~np.eye(*found.shape, dtype=np.bool_)
    return float((1.0 / (1.0 + found[others] / SETTLED)).sum())


def _weighted(layout: Layout, gram: Array) -> Iterator[_Products]:
    n = layout.traces
    traces, numbers, between = gram[:n, :n], gram[n:, n:], gram[n:, :n]
    count = len(numbers)
    for weight in _WEIGHTS:
        lower = np.linalg.cholesky(numbers + (1.0 + weight) * np.eye(count))
        shared = np.linalg.solve(lower, between)
        yield _Products(
            np.diag(traces) - (shared**2).sum(axis=0),
            traces[layout.usual] - shared[:, layout.usual].T @ shared,
            np.diag(traces, 1) - (shared[:, :-1] * shared[:, 1:]).sum(axis=0),
            weight * _BOUND * count,
        )


def _distances(layout: Layout, products: _Products) -> Array:
    """(causes, traces) distance from each typical trace to the line from each trace to the next one."""
    own, cross, following, slack = products
    length = own[:-1] + own[1:] - 2.0 * following
    along = cross[:, 1:] - cross[:, :-1] - following + own[:-1]
    share = np.clip(along / np.maximum(length, 1e-12), 0.0, 1.0)
    # There is no line from the last strength of a cause to the first of the next cause.
    share[:, layout.first[1:] - 1] = 0.0
    left = own[layout.usual, None] + own - 2.0 * cross
    left[:, :-1] += share * (share * length - 2.0 * along)
    distances: Array = left - slack
    return distances


class FullFits:
    """Distances by full fits, as in a diagnosis, to the simulated readings of one plan.

    The runs are simulated with cause A in the rig, without noise, with the inputs of the nominal rig. Cause B
    is fitted to them: its strength, the rig numbers within their tolerances, and all initial pressures. The
    fit starts at the strength at which B's trace is most similar to A's. The remaining cost is Δχ².
    """

    def __init__(self, layout: Layout, parts: Sequence[CandidatePart]) -> None:
        self._layout = layout
        self._runs = tuple(nominal_run(layout.rig, part.kind) for part in parts)
        self._initial = [np.array([[part.kind.reservoir_kPa, 0.0]]) for part in parts]
        self._gram = gram_of(layout, parts)

    def distance(self, there: int, fitted: int) -> float:
        """Δχ² if `there` is in the rig and `fitted` is fitted; both are column numbers of the matrix."""
        layout = self._layout
        problem = FitProblem(self._case(there), layout.noise)
        start = replace(problem.start().with_free(layout.keys), initial=np.concatenate(self._initial))
        for known, values in layout.known:
            start = start.with_cause(known, values)
        if fitted < len(layout.causes):
            cause = layout.causes[fitted]
            value = nearest(layout, self._gram, there, fitted)
            start = start.with_cause(cause, (value, *layout.rest[fitted]))
        return problem.fit(start).cost

    def _case(self, there: int) -> Case:
        layout = self._layout
        cause = layout.causes[there]
        value = layout.values[there][layout.usual[there] - layout.first[there]]
        causes = [*layout.known, (cause, (value, *layout.rest[there]))]
        bare = Case(Path("plan"), layout.rig, self._runs, ())
        simulation = Simulation(bare)
        runs = []
        for index, (run, initial) in enumerate(zip(self._runs, self._initial, strict=True)):
            readings = simulation.readings(index, {}, causes, initial)
            cv_kPa = np.full_like(run.time_s, np.nan) if run.to_atmosphere else readings.cv_kPa
            runs.append(replace(run, cv_kPa=cv_kPa, reservoir_kPa=readings.reservoir_kPa))
        return replace(bare, runs=tuple(runs))


class RecordingBudget:
    """The limits of time and air, and the share of them that runs use."""

    def __init__(self, layout: Layout, seconds: float, air_SL: float) -> None:
        self._seconds, self._air_SL = seconds, air_SL
        self._SL_per_kPa = layout.rig.reservoir.volume_L / ALPHA_KPA

    def air_SL(self, parts: Iterable[CandidatePart]) -> float:
        """Air that leaves the reservoir in these runs, and between them to reach the next start pressure."""
        total_SL, reservoir_kPa = 0.0, 0.0
        for part in in_order(parts):
            start_kPa = part.kind.reservoir_kPa
            total_SL += max(0.0, reservoir_kPa - start_kPa) * self._SL_per_kPa + part.air_SL
            reservoir_kPa = start_kPa - part.air_SL / self._SL_per_kPa
        return total_SL

    def share(self, parts: Sequence[CandidatePart]) -> float:
        """Used share of the scarcer limit (time or air); above 1 the runs do not fit."""
        time = sum(part.seconds for part in parts) / self._seconds
        return max(time, self.air_SL(parts) / self._air_SL) - _ROUNDING


def in_order(parts: Iterable[CandidatePart]) -> list[CandidatePart]:
    """The runs by falling start pressure, so that the reservoir is filled as rarely as possible."""
    return sorted(parts, key=lambda part: (-part.kind.reservoir_kPa, part.candidate.name))


def gram_of(layout: Layout, parts: Iterable[CandidatePart]) -> Array:
    """The matrix G (see `traces`) of several runs together."""
    return sum((part.gram for part in parts), start=layout.nothing)


def choose(layout: Layout, parts: Sequence[CandidatePart], budget: RecordingBudget) -> list[CandidatePart]:
    """The runs of a plan, in the order of recording; at most one length of each candidate."""
    # Lowering the reservoir to a low start pressure can use all the air. So one plan is made for each lowest
    # start pressure, and the best plan is used.
    lowest = sorted({part.kind.reservoir_kPa for part in parts})
    plans = [_chosen(layout, [p for p in parts if p.kind.reservoir_kPa >= low], budget) for low in lowest]
    return in_order(min(plans, key=lambda chosen: _open(layout, gram_of(layout, chosen)), default=[]))


def _chosen(layout: Layout, parts: Sequence[CandidatePart], budget: RecordingBudget) -> list[CandidatePart]:
    chosen: list[CandidatePart] = []
    for _ in range(_MAX_EXCHANGES):
        while (longer := _one_more(layout, parts, chosen, budget)) is not None:
            chosen = longer
        if (other := _exchanged(layout, parts, chosen, budget)) is None:
            break
        chosen = other
    return chosen


def _one_more(
    layout: Layout, parts: Sequence[CandidatePart], chosen: list[CandidatePart], budget: RecordingBudget
) -> list[CandidatePart] | None:
    gram = gram_of(layout, chosen)
    before, share = _open(layout, gram), budget.share(chosen)
    best, best_rate = None, 0.0
    for part in _others(parts, chosen):
        longer = [*chosen, part]
        takes = budget.share(longer)
        gain = before - _open(layout, gram + part.gram) if takes <= 1.0 else 0.0
        if gain > MIN_GAIN and gain > best_rate * max(takes - share, 1e-3):
            best, best_rate = longer, gain / max(takes - share, 1e-3)
    return best


def _exchanged(
    layout: Layout, parts: Sequence[CandidatePart], chosen: list[CandidatePart], budget: RecordingBudget
) -> list[CandidatePart] | None:
    """The best exchange of one run that leaves fewer pairs open; None if there is none."""
    lowest = _open(layout, gram_of(layout, chosen)) - MIN_GAIN
    best = None
    for index in range(len(chosen)):
        rest = [*chosen[:index], *chosen[index + 1 :]]
        gram = gram_of(layout, rest)
        for part in _others(parts, rest):
            other = [*rest, part]
            if budget.share(other) <= 1.0 and (left := _open(layout, gram + part.gram)) < lowest:
                best, lowest = other, left
    return best


def _others(parts: Sequence[CandidatePart], chosen: Sequence[CandidatePart]) -> list[CandidatePart]:
    names = {part.candidate.name for part in chosen}
    return [part for part in parts if part.candidate.name not in names]


def _open(layout: Layout, gram: Array) -> float:
    return open_pairs(cause_distances(layout, gram))
