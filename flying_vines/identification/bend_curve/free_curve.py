"""A free rising curve for a vine that does not follow the law: with an S, a kink, or a second dead zone.

The curve is piecewise linear between evenly spaced pressures and never falls. The pressure first passes a
backlash of width h. For each h the pieces are a non-negative least-squares problem; h minimises the
residuals. The 95 % interval of h is from its likelihood profile: the sum of squares stays below a limit that
follows from the F distribution. Correlated neighbouring residuals are counted with their effective number.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq, minimize_scalar, nnls
from scipy.special import fdtri

from flying_vines.identification.bend_curve.pairs import Pairs
from flying_vines.identification.bend_curve.sequence import (
    CurveEstimate,
    Explanation,
    bent_kPa,
    pairs_per_independent,
    rounded,
)
from flying_vines.physics.arrays import Array

MAX_PIECES = 12
PAIRS_PER_PIECE = 5
TRIED = 24
"""Number of widths on the grid at which the search for h starts."""


def fit_free_curve(pairs: Pairs) -> Explanation:
    """The best rising curve and hysteresis."""
    kPa, deg = pairs.pressure_kPa, pairs.angle_deg
    pieces = max(2, min(MAX_PIECES, len(kPa) // PAIRS_PER_PIECE))
    knots = np.linspace(float(np.min(kPa)), float(np.max(kPa)), pieces + 1)

    def solve(width_kPa: float) -> tuple[Array, float]:
        bent = bent_kPa(kPa, width_kPa)
        passed = np.clip((bent[:, None] - knots[:-1]) / np.diff(knots), 0.0, 1.0)
        rises, rest = nnls(np.column_stack([np.ones(len(kPa)), passed]), deg)
        return rises, rest**2

    def squares(width_kPa: float) -> float:
        return solve(width_kPa)[1]

    width_kPa, widest_kPa = 0.0, 0.9 * float(np.ptp(kPa))
    if pairs.unloads:
        tried = np.linspace(0.0, widest_kPa, TRIED)
        near = int(np.argmin([squares(width) for width in tried]))
        bounds = tried[max(0, near - 1)], tried[min(TRIED - 1, near + 1)]
        width_kPa = float(minimize_scalar(squares, bounds=bounds, method="bounded").x)
    rises, lowest = solve(width_kPa)
    angles = np.cumsum(rises)
    residual = deg - np.interp(bent_kPa(kPa, width_kPa), knots, angles)
    numbers = int(np.count_nonzero(rises)) + int(pairs.unloads)
    hysteresis = CurveEstimate(width_kPa, width_kPa, width_kPa)
    if pairs.unloads:
        shared = pairs_per_independent(residual)
        free = max(len(kPa) / shared - numbers, 1.0)
        allowed = lowest * (1.0 + float(fdtri(1, free, 0.95)) / free)

        def beyond(width: float) -> float:
            return squares(width) - allowed

        low = brentq(beyond, 0.0, width_kPa, xtol=1e-4) if beyond(0.0) > 0.0 else 0.0
        high = brentq(beyond, width_kPa, widest_kPa, xtol=1e-4) if beyond(widest_kPa) > 0.0 else widest_kPa
        hysteresis = CurveEstimate(width_kPa, float(low), float(high))
    return Explanation(rounded(knots, angles), hysteresis, residual, numbers)
