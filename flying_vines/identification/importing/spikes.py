"""Finds spikes: single readings far from their neighbours. A motor or a valve causes them."""

from __future__ import annotations

import numpy as np

from flying_vines.physics.arrays import Array, BoolArray

_WIDTH = 5
"""Width of the running median in readings: it finds up to two spikes in succession, and keeps steps."""
_MIN_SPAN = 0.1
"""Minimum distance of a spike from its neighbours, over the span of the other readings."""
_MIN_NOISE = 12.0
"""Minimum distance in standard deviations of the noise."""
_SMOOTH = 0.98
"""Share of the steps between the other readings that must be smaller than half the smallest spike."""
_MAX_SHARE = 0.1
"""If a larger share of the readings looks like spikes, none of them counts as a spike."""


def without_spikes(readings: Array) -> Array:
    """The readings without spikes and missing ones."""
    kept: Array = readings[np.isfinite(readings) & ~is_spike(readings)]
    return kept


def is_spike(readings: Array) -> BoolArray:
    """True for each spike; all False if too many look like spikes. Missing readings are no spikes."""
    found = np.zeros(len(readings), dtype=bool)
    there = np.flatnonzero(np.isfinite(readings))
    few, nearest = _MAX_SHARE * len(there), np.inf
    while len(there) >= 4 * _WIDTH:
        x = readings[there]
        padded = np.pad(x, _WIDTH // 2, mode="edge")
        middle = np.median(np.lib.stride_tricks.sliding_window_view(padded, _WIDTH), axis=1)
        distance = np.abs(x - middle)
        noise = 1.48 * float(np.median(distance[distance > 0.0])) if (distance > 0.0).any() else 0.0
        far = distance > max(_MIN_SPAN * float(np.ptp(middle)), _MIN_NOISE * noise)
        if not far.any():
            # If the pressure itself moves as far between readings, a single far reading may be real.
            smooth = 2.0 * float(np.quantile(np.abs(np.diff(middle)), _SMOOTH)) < nearest
            return found if smooth and found.sum() <= few else np.zeros_like(found)
        nearest = min(nearest, float(np.min(distance[far])))
        found[there[far]] = True
        there = there[~far]
    return np.zeros_like(found)
