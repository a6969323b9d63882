"""An exponential law with four numbers, which most vines follow.

θ = θ_max (1 − exp(−(u − P_d)/P_s)) above the dead zone P_d, and 0 below. u is the pressure after a backlash
of width h: on the way up it is the pressure itself. The fit is least squares over all pairs in their order.
The 95 % intervals are from the curvature at the best fit and Student's t. They are widened for correlated
neighbouring residuals, so that denser measurements do not make a poor fit look certain.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from scipy.special import stdtrit

from flying_vines.identification.bend_curve.pairs import Pairs
from flying_vines.identification.bend_curve.sequence import (
    CurveEstimate,
    Explanation,
    bent_kPa,
    pairs_per_independent,
    rounded,
)
from flying_vines.physics.arrays import Array

KNOTS = 10
"""Number of linear pieces of the written curve. Their error is at most 1 % of the largest angle."""


class Law(NamedTuple):
    """The numbers of the law."""

    bend_max_deg: float
    """θ_max, the limit of the bend at high pressure."""
    dead_kPa: float
    """P_d, the pressure up to which the vine stays straight."""
    scale_kPa: float
    """P_s, the rise of pressure over which the bend that remains to θ_max falls by a factor e."""
    hysteresis_kPa: float
    """h, the width of the backlash."""

    def curve_deg(self, bent: Array) -> Array:
        """Angle over pressure on the way up."""
        over = np.maximum(0.0, bent - self.dead_kPa) / self.scale_kPa
        return -self.bend_max_deg * np.expm1(-over)

    def angles_deg(self, pressure_kPa: Array) -> Array:
        """Angle of each pair; the first pair is on the way up."""
        return self.curve_deg(bent_kPa(pressure_kPa, self.hysteresis_kPa))


def fit_law(pairs: Pairs) -> tuple[Law, list[CurveEstimate], Explanation]:
    """The best law; its first three numbers with intervals; its curve, hysteresis and residuals."""
    kPa, deg = pairs.pressure_kPa, pairs.angle_deg
    span, top = float(np.ptp(kPa)), float(np.ptp(deg))
    widest = 0.9 * span if pairs.unloads else 0.0
    lower = np.array([0.0, 0.0, 1e-3 * span, 0.0])
    upper = np.array([1e4, float(np.max(kPa)), 30.0 * span, widest + 1e-12])

    def errors_deg(numbers: Array) -> Array:
        return Law(*numbers).angles_deg(kPa) - deg

    best: OptimizeResult | None = None
    for dead, scale, width in itertools.product((0.0, 0.3), (0.3, 1.0), (0.05, 0.3)):
        start = np.array([1.2 * top, dead * np.max(kPa), scale * span, min(width * span, 0.9 * widest)])
        found = least_squares(
            errors_deg, np.clip(start, lower, upper), bounds=(lower, upper), x_scale=[top, span, span, span]
        )
        if best is None or found.cost < best.cost:
            best = found
    assert best is not None
    law = Law(*(float(x) for x in best.x))
    numbers = 4 if pairs.unloads else 3
    estimates = _estimates(law, best.jac[:, :numbers], -best.fun)
    hysteresis = estimates[3] if pairs.unloads else CurveEstimate(0.0, 0.0, 0.0)
    return law, estimates[:3], Explanation(_curve(law, float(np.max(kPa))), hysteresis, -best.fun, numbers)


def _estimates(law: Law, jacobian: Array, residual: Array) -> list[CurveEstimate]:
    count, numbers = jacobian.shape
    shared = pairs_per_independent(residual)
    sigma = math.sqrt(float(residual @ residual) / max(count - numbers, 1) * shared)
    quantile = float(stdtrit(max(count / shared - numbers, 1.0), 0.975))
    reach = quantile * sigma * np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian)))
    return [
        CurveEstimate(value, max(0.0, value - float(width)), value + float(width))
        for value, width in zip(law, reach, strict=False)
    ]


def _curve(law: Law, max_kPa: float) -> tuple[tuple[float, float], ...]:
    reach = max(0.0, max_kPa - law.dead_kPa) / law.scale_kPa
    # Pieces of about equal error: the density of the knots is proportional to the root of the curvature.
    over = -2.0 * np.log1p(np.expm1(-0.5 * reach) * np.arange(KNOTS + 1) / KNOTS)
    kPa = law.dead_kPa + law.scale_kPa * over
    return rounded(kPa, law.curve_deg(kPa))
