"""Chooses the runs of a plan within limits of time and air.

Runs are added one by one. Each time, the run with the largest gain for its use of the scarcer limit (time or
air) is added. Then runs are exchanged while that improves the plan. The gain is the reduction of
`open_pairs`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from flying_vines.identification.plan.cause_distance import cause_distances, open_pairs
from flying_vines.identification.plan.traces import CandidatePart, Layout
from flying_vines.physics.arrays import Array
from flying_vines.physics.constants import ALPHA_KPA

MIN_GAIN = 0.03
"""A run that reduces `open_pairs` by less is not added."""
_MAX_EXCHANGES = 20
_ROUNDING = 1e-6


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
    other: list[CandidatePart] | None = chosen
    for _ in range(_MAX_EXCHANGES):
        if other is None:
            break
        chosen = other
        while (longer := _one_more(layout, parts, chosen, budget)) is not None:
            chosen = longer
        other = _exchanged(layout, parts, chosen, budget)
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
