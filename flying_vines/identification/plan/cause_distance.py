"""Distance of two causes on the runs of a plan: the χ² that remains if the wrong cause is fitted.

Cause A is in the rig at its typical strength. Cause B is fitted to the noiseless readings: its strength, the
rig numbers within their tolerances, and the initial pressures. The remaining Δχ² is the evidence for A; its
square root is the distance in standard deviations. It can be computed from traces (`traces`) instead of
simulations: from A's trace a, the polyline b through B's traces, and the best change ν of the rig numbers,

    Δχ² = min |a − b − Nν|² + |ν|²   within   |νᵢ| ≤ √3    (ν in standard deviations of a uniform prior)

For any w ≥ 0 the unbounded minimum of |a − b − Nν|² + |ν|² + w Σ(νᵢ² − 3) is a lower bound of Δχ², and
follows from a linear equation. The code uses the maximum of these bounds over a few w.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from flying_vines.identification.plan.traces import Layout
from flying_vines.physics.arrays import Array

SETTLED = 25.0
"""Δχ² from which two causes count as separated: five standard deviations, as for a claim of the diagnosis."""
_WEIGHTS = (0.0, 10.0, 100.0, 1000.0)
_BOUND = 3.0


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
