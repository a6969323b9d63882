"""Which runs, within the time and the air that there are.

One run after the other, each time the one that settles most for what it takes of what is scarcer; then each
is exchanged for another where that settles more. `open_pairs` weighs what is settled.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from flying_vines.identification.plan.apart import apart, open_pairs
from flying_vines.identification.plan.traces import CandidatePart, Layout
from flying_vines.physics.arrays import Array
from flying_vines.physics.constants import ALPHA_KPA

WORTH = 0.03
"""Pairs. A run that settles less is not worth the trouble."""
_MOST_EXCHANGES = 20
_ROUNDING = 1e-6


class RecordingBudget:
    """What a plan may take, and whether it fits."""

    def __init__(self, layout: Layout, seconds: float, air_SL: float) -> None:
        self._seconds, self._air_SL = seconds, air_SL
        self._SL_per_kPa = layout.rig.reservoir.volume_L / ALPHA_KPA

    def air_SL(self, parts: Iterable[CandidatePart]) -> float:
        """That leaves the reservoir in these runs, and between them where it is let down to the next."""
        total_SL, reservoir_kPa = 0.0, 0.0
        for part in in_order(parts):
            start_kPa = part.kind.reservoir_kPa
            total_SL += max(0.0, reservoir_kPa - start_kPa) * self._SL_per_kPa + part.air_SL
            reservoir_kPa = start_kPa - part.air_SL / self._SL_per_kPa
        return total_SL

    def share(self, parts: Sequence[CandidatePart]) -> float:
        """Of what is scarcer; above 1 it does not fit."""
        time = sum(part.seconds for part in parts) / self._seconds
        return max(time, self.air_SL(parts) / self._air_SL) - _ROUNDING


def in_order(parts: Iterable[CandidatePart]) -> list[CandidatePart]:
    """As they are to be done: the reservoir need never be filled higher than before."""
    return sorted(parts, key=lambda part: (-part.kind.reservoir_kPa, part.candidate.name))


def gram_of(layout: Layout, parts: Iterable[CandidatePart]) -> Array:
    """Of several runs together."""
    return sum((part.gram for part in parts), start=layout.nothing)


def choose(layout: Layout, parts: Sequence[CandidatePart], budget: RecordingBudget) -> list[CandidatePart]:
    """The runs of a plan, in the order in which they are to be done; at most one length of each candidate."""
    # To let the reservoir down may take all the air there is, so how far down is tried first.
    lowest = sorted({part.kind.reservoir_kPa for part in parts})
    plans = [_chosen(layout, [p for p in parts if p.kind.reservoir_kPa >= low], budget) for low in lowest]
    return in_order(min(plans, key=lambda chosen: _open(layout, gram_of(layout, chosen)), default=[]))


def _chosen(layout: Layout, parts: Sequence[CandidatePart], budget: RecordingBudget) -> list[CandidatePart]:
    chosen: list[CandidatePart] = []
    other: list[CandidatePart] | None = chosen
    for _ in range(_MOST_EXCHANGES):
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
    best, most = None, 0.0
    for part in _others(parts, chosen):
        longer = [*chosen, part]
        takes = budget.share(longer)
        gain = before - _open(layout, gram + part.gram) if takes <= 1.0 else 0.0
        if gain > WORTH and gain > most * max(takes - share, 1e-3):
            best, most = longer, gain / max(takes - share, 1e-3)
    return best


def _exchanged(
    layout: Layout, parts: Sequence[CandidatePart], chosen: list[CandidatePart], budget: RecordingBudget
) -> list[CandidatePart] | None:
    """With one run less and another instead, where that leaves fewer pairs open."""
    least = _open(layout, gram_of(layout, chosen)) - WORTH
    best = None
    for index in range(len(chosen)):
        rest = [*chosen[:index], *chosen[index + 1 :]]
        gram = gram_of(layout, rest)
        for part in _others(parts, rest):
            other = [*rest, part]
            if budget.share(other) <= 1.0 and (left := _open(layout, gram + part.gram)) < least:
                best, least = other, left
    return best


def _others(parts: Sequence[CandidatePart], chosen: Sequence[CandidatePart]) -> list[CandidatePart]:
    names = {part.candidate.name for part in chosen}
    return [part for part in parts if part.candidate.name not in names]


def _open(layout: Layout, gram: Array) -> float:
    return open_pairs(apart(layout, gram))
