"""Fits a bend curve to measured pairs of pressure and angle, up and down. Needs numpy and scipy.

pairs = load_pairs(Path("pairs.csv"))
found = fit(pairs)
found.hysteresis_kPa, found.rms_deg, found.curve
print(found.table)                          for the configuration

An exponential law with four numbers is used, unless a free rising curve explains the pairs far better. Both
use the backlash model of `BendCurve`, as the service does.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import accumulate, product
from typing import NamedTuple

import numpy as np
from scipy.optimize import OptimizeResult, brentq, least_squares, minimize_scalar, nnls
from scipy.special import fdtri, stdtrit

from flying_vines.identification.bend_curve.pairs import Pairs, PairsError, load_pairs, parse_pairs
from flying_vines.physics.arrays import Array
from flying_vines.vine.curve import BendCurve

__all__ = ["BendCurveFit", "CurveEstimate", "Law", "Pairs", "PairsError", "fit", "load_pairs", "parse_pairs"]

KNOTS = 10
"""Number of linear pieces of the written curve. Their error is at most 1 % of the largest angle."""
MAX_PIECES = 12
PAIRS_PER_PIECE = 5
TRIED = 24
"""Number of widths on the grid at which the search for h starts."""
FAR_BETTER = 10.0
"""Difference of the information criterion (BIC) that counts as very strong evidence."""
POOR = 0.05
"""Residuals above this share of the range of angles give a note."""
SLOW_KPA_PER_S = 2.0
"""At a faster rate, lag looks like hysteresis."""


class CurveEstimate(NamedTuple):
    """A value and its 95 % interval."""

    value: float
    low: float
    high: float


class Explanation(NamedTuple):
    """A curve and a hysteresis, and the residuals of the measured angles."""

    curve: tuple[tuple[float, float], ...]
    """Pairs [kPa, degrees] on the way up, within the measured range."""
    hysteresis_kPa: CurveEstimate
    residual_deg: Array
    numbers: int
    """Count of fitted numbers."""

    @property
    def rms_deg(self) -> float:
        return float(np.sqrt(np.mean(self.residual_deg**2)))

    @property
    def bic(self) -> float:
        """Bayesian information criterion for independent errors; lower is better."""
        count = len(self.residual_deg)
        return count * float(np.log(np.mean(self.residual_deg**2) + 1e-12)) + self.numbers * float(
            np.log(count)
        )


def bent_kPa(pressure_kPa: Array, hysteresis_kPa: float) -> Array:
    """`BendCurve.bent_kPa` along a sequence that starts on the way up."""
    steps = accumulate(pressure_kPa.tolist(), lambda bent, kPa: min(max(bent, kPa), kPa + hysteresis_kPa))
    return np.array(list(steps))


def pairs_per_independent(residual: Array) -> float:
    """Number of pairs for each independent residual, from the lag-1 autocorrelation; 1 if uncorrelated."""
    power = float(residual @ residual)
    correlation = max(0.0, float(residual[1:] @ residual[:-1]) / power) if power > 0.0 else 0.0
    return (1.0 + correlation) / max(1.0 - correlation, 1.0 / len(residual))


def rounded(kPa: Array, deg: Array) -> tuple[tuple[float, float], ...]:
    """Rounded pairs for `BendCurve` that start at (0, 0); empty if the vine does not bend."""
    pairs = [(0.0, 0.0)]
    for pressure, angle in zip(kPa.tolist(), deg.tolist(), strict=True):
        pair = (round(pressure, 2), round(max(angle, pairs[-1][1]), 2))
        if pair[0] > pairs[-1][0]:
            pairs.append(pair)
    return tuple(pairs) if pairs[-1][1] > 0.0 else ()


class Law(NamedTuple):
    """An exponential law with four numbers, which most vines follow.

    θ = θ_max (1 − exp(−(u − P_d)/P_s)) above the dead zone P_d, and 0 below. u is the pressure after a
    backlash of width h: on the way up it is the pressure itself.
    """

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
    """The best law; its first three numbers with intervals; its curve, hysteresis and residuals.

    The fit is least squares over all pairs in their order. The 95 % intervals are from the curvature at the
    best fit and Student's t. They are widened for correlated neighbouring residuals, so that denser
    measurements do not make a poor fit look certain.
    """
    kPa, deg = pairs.pressure_kPa, pairs.angle_deg
    span, top = float(np.ptp(kPa)), float(np.ptp(deg))
    widest = 0.9 * span if pairs.unloads else 0.0
    lower = np.array([0.0, 0.0, 1e-3 * span, 0.0])
    upper = np.array([1e4, float(np.max(kPa)), 30.0 * span, widest + 1e-12])

    def errors_deg(numbers: Array) -> Array:
        return Law(*numbers).angles_deg(kPa) - deg

    best: OptimizeResult | None = None
    for dead, scale, width in product((0.0, 0.3), (0.3, 1.0), (0.05, 0.3)):
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


def fit_free_curve(pairs: Pairs) -> Explanation:
    """The best rising curve, and its hysteresis, of a vine with an S, a kink, or a second dead zone.

    The curve is piecewise linear between evenly spaced pressures and never falls. The pressure first passes a
    backlash of width h. For each h the pieces are a non-negative least-squares problem; h minimises the
    residuals. The 95 % interval of h is from its likelihood profile: the sum of squares stays below a limit
    that follows from the F distribution. Correlated neighbouring residuals are counted with their effective
    number.
    """
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


@dataclass(frozen=True)
class BendCurveFit:
    """Bend curve and hysteresis of a vine, with intervals and residuals."""

    pairs: Pairs
    law: Law
    bend_max_deg: CurveEstimate
    dead_kPa: CurveEstimate
    scale_kPa: CurveEstimate
    law_rms_deg: float
    """Root mean square of the law's residuals, also if the law is not used."""
    follows_law: bool
    """True if the curve is the law's; False if the free curve is far better."""
    hysteresis_kPa: CurveEstimate | None
    """None if no way down was measured."""
    curve: tuple[tuple[float, float], ...]
    """Pairs [kPa, degrees] on the way up, within the measured range."""
    residual_deg: Array
    """Residual of each pair."""

    @property
    def rms_deg(self) -> float:
        return float(np.sqrt(np.mean(self.residual_deg**2)))

    @property
    def written_hysteresis_kPa(self) -> float:
        """The value for the configuration: 0 if its interval includes 0."""
        found = self.hysteresis_kPa
        return round(found.value, 2) if found and found.low > 0.0 else 0.0

    @property
    def table(self) -> str:
        """The table [vine] of the configuration."""
        pairs = ", ".join(f"[{kPa:g}, {deg:g}]" for kPa, deg in self.curve)
        return f"[vine]\ncurve = [{pairs}]\nhysteresis_kPa = {self.written_hysteresis_kPa:g}\n"

    @property
    def notes(self) -> tuple[str, ...]:
        """Warnings for the user, before the curve is used."""
        return tuple(_notes(self))


def fit(pairs: Pairs) -> BendCurveFit:
    """The best curve and hysteresis for measured pairs.

    Raises `PairsError` if no rising curve fits the pairs.
    """
    law, (bend_max_deg, dead_kPa, scale_kPa), by_law = fit_law(pairs)
    by_curve = fit_free_curve(pairs)
    follows_law = by_law.bic <= by_curve.bic + FAR_BETTER
    chosen: Explanation = by_law if follows_law else by_curve
    if not chosen.curve:
        raise PairsError("no curve that rises from 0° fits the angles; 0° is the straight vine")
    return BendCurveFit(
        pairs=pairs,
        law=law,
        bend_max_deg=bend_max_deg,
        dead_kPa=dead_kPa,
        scale_kPa=scale_kPa,
        law_rms_deg=by_law.rms_deg,
        follows_law=follows_law,
        hysteresis_kPa=chosen.hysteresis_kPa if pairs.unloads else None,
        curve=chosen.curve,
        residual_deg=chosen.residual_deg,
    )


def _notes(found: BendCurveFit) -> Iterator[str]:
    hysteresis, curve = found.hysteresis_kPa, BendCurve(found.curve)
    if not found.follows_law:
        yield (
            f"The residuals of the law are {found.law_rms_deg:.1f}°, those of a free rising curve "
            f"{found.rms_deg:.1f}° (rms): the free curve and its hysteresis are used."
        )
    elif found.law.bend_max_deg > 2.0 * curve.max_deg:
        yield "The bend does not level off within the measured range: its maximum angle is extrapolated."
    if hysteresis is None:
        yield "No way down was measured: the hysteresis is unknown and written as 0."
    elif found.written_hysteresis_kPa == 0.0:
        yield "The residuals show no hysteresis; it is written as 0."
    elif (left_deg := curve.angle_deg(hysteresis.value)) > 0.01 * curve.max_deg:
        yield f"The hysteresis is wider than the dead zone: a vented vine may stay bent by {left_deg:.1f}°."
    if found.rms_deg > POOR * float(np.ptp(found.pairs.angle_deg)):
        yield f"The residuals are large, {found.rms_deg:.1f}° (rms): look at the picture before you use it."
    rate = found.pairs.rate_kPa_per_s
    if rate is not None and rate > SLOW_KPA_PER_S:
        yield f"The pressure moved by {rate:.1f} kPa/s: lag may look like hysteresis; measure more slowly."
