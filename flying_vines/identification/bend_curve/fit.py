"""Fits bend curve and hysteresis to measured pairs, ready for the configuration.

An exponential law with four numbers is used, unless a free rising curve explains the pairs far better. Both
use the backlash model of `BendCurve`, as the service does.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from flying_vines.identification.bend_curve.free_curve import fit_free_curve
from flying_vines.identification.bend_curve.law import Law, fit_law
from flying_vines.identification.bend_curve.pairs import Pairs, PairsError
from flying_vines.identification.bend_curve.sequence import CurveEstimate, Explanation
from flying_vines.physics.arrays import Array
from flying_vines.vine.curve import BendCurve

FAR_BETTER = 10.0
"""Difference of the information criterion (BIC) that counts as very strong evidence."""
POOR = 0.05
"""Residuals above this share of the range of angles give a note."""
SLOW_KPA_PER_S = 2.0
"""At a faster rate, lag looks like hysteresis."""


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
