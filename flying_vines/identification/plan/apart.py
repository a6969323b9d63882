"""How far apart causes are on the runs of a plan: the χ² that the wrong one would leave.

Let A be there at its typical strength. B is fitted to what is read: its strength, the believed numbers within
their tolerances, the initial pressures. What is left, without noise, is by how much χ² prefers A; its root is
the number of standard deviations between them. With traces instead of simulations (`traces`) that is the
distance between A's trace and the line that B's traces draw, as much of it as the numbers ν cannot imitate:

    Δχ² = min |a − b − Nν|² + |ν|²   within   |νᵢ| ≤ √3    (ν in standard deviations of a uniform belief)

For any w ≥ 0 the least of |a − b − Nν|² + |ν|² + w Σ(νᵢ² − 3), with no bounds, is no greater. So the greatest
of these over a few w is a floor under Δχ², and it takes a linear equation instead of a bounded search.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from flying_vines.identification.plan.traces import Layout
from flying_vines.physics.arrays import Array

SETTLED = 25.0
"""Δχ² from which two causes are told apart: five standard deviations, as the diagnosis asks of a claim."""
_WEIGHTS = (0.0, 10.0, 100.0, 1000.0)
_BOUND = 3.0


class _Products(NamedTuple):
    """Of traces, as far as the believed numbers cannot imitate them."""

    own: Array
    """(traces,) each with itself."""
    cross: Array
    """(causes, traces) those at typical strength with all."""
    beside: Array
    """(traces - 1,) each with its next."""
    slack: float
    """What is to be taken from distances."""


def apart(layout: Layout, gram: Array) -> Array:
    """(causes, causes + 1) Δχ² between what is there (rows) and what is fitted; the last column is none."""
    left = np.full((len(layout.causes), layout.traces), -np.inf)
    alone = np.zeros(len(layout.causes))
    for products in _weighted(layout, gram):
        left = np.maximum(left, _distances(layout, products))
        alone = np.maximum(alone, products.own[layout.usual] - products.slack)
    found = np.minimum.reduceat(np.maximum(left, 0.0), layout.first, axis=1)
    return np.column_stack((found, alone))


def nearest(layout: Layout, gram: Array, there: int, fitted: int) -> float:
    """At which of its strengths, a value of its first parameter, `fitted` looks most like `there`."""
    values, first = layout.values[fitted], layout.first[fitted]
    rows = slice(first, first + len(values))
    distance = np.full(len(values), -np.inf)
    for own, cross, _, slack in _weighted(layout, gram):
        distance = np.maximum(
            distance, own[rows] - 2.0 * cross[there, rows] + own[layout.usual[there]] - slack
        )
    # Where a cause does nothing no fit finds the way out.
    idle = [value == layout.causes[fitted].parameters[0].neutral for value in values]
    return values[int(np.argmin(np.where(idle, np.inf, distance)))]


def open_pairs(found: Array) -> float:
    """About how many pairs are left open, of all: a pair that is settled by far counts little, one of which
    nothing is known counts one, and one at `SETTLED` a half."""
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
    """(causes, traces) from each typical trace to each trace of all, and on from there towards its next."""
    own, cross, beside, slack = products
    length = own[:-1] + own[1:] - 2.0 * beside
    along = cross[:, 1:] - cross[:, :-1] - beside + own[:-1]
    share = np.clip(along / np.maximum(length, 1e-12), 0.0, 1.0)
    # The last strength of one cause has no line to the first of the next.
    share[:, layout.first[1:] - 1] = 0.0
    left = own[layout.usual, None] + own - 2.0 * cross
    left[:, :-1] += share * (share * length - 2.0 * along)
    distances: Array = left - slack
    return distances
