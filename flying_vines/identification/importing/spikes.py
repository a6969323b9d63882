"""Single readings far from their neighbours, as a disturbed sensor gives them beside a motor or a valve."""

from __future__ import annotations

import numpy as np

from flying_vines.physics.arrays import Array, BoolArray

_WIDTH = 5
"""Readings of the running median: up to two spikes in succession are seen, and steps remain."""
_MIN_SPAN = 0.1
"""Minimum distance of a spike from its neighbours, over the span of the other readings."""
_MIN_NOISE = 12.0
"""Minimum distance in standard deviations of the noise."""
_MAX_SHARE = 0.1
"""More spikes than this are no spikes."""


def without_spikes(readings: Array) -> Array:
    """The readings that are no spikes, without missing ones."""
    kept: Array = readings[np.isfinite(readings) & ~is_spike(readings)]
    return kept


def is_spike(readings: Array) -> BoolArray:
    """True for each spike; none if they are too many. Missing readings are no spikes."""
    found = np.zeros(len(readings), dtype=bool)
    there = np.flatnonzero(np.isfinite(readings))
    if len(there) < 4 * _WIDTH:
        return found
    x = readings[there]
    padded = np.pad(x, _WIDTH // 2, mode="edge")
    middle = np.median(np.lib.stride_tricks.sliding_window_view(padded, _WIDTH), axis=1)
    distance = np.abs(x - middle)
    noise = 1.48 * float(np.median(distance[distance > 0.0])) if (distance > 0.0).any() else 0.0
    # Where the pressure itself moves as far from reading to reading, a single one may be true.
    moves = float(np.max(np.abs(np.diff(middle))))
    far = distance > max(_MIN_SPAN * float(np.ptp(middle)), _MIN_NOISE * noise, 2.0 * moves)
    if np.mean(far) <= _MAX_SHARE:
        found[there] = far
    return found
