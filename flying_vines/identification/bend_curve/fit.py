"""The bend curve and the hysteresis that explain measured pairs best, ready for the configuration.

First the law of four numbers; where any rising curve explains the pairs far better, that curve instead.
Both are behind the play by which `BendCurve` names bends, so that what is fitted here is what flies.
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
"""Of the information criterion: very strong evidence, by the usual reading."""
POOR = 0.05
"""Of the span of angles: residuals beyond it are worth a look."""
SLOW_KPA_PER_S = 2.0
"""Faster, lag looks like hysteresis."""


@dataclass(frozen=True)
class BendCurveFit:
    """What was found of a vine."""

    pairs: Pairs
    law: Law
    bend_max_deg: CurveEstimate
    dead_kPa: CurveEstimate
    scale_kPa: CurveEstimate
    law_rms_deg: float
    """What the law leaves of the angles."""
    follows_law: bool
    """Whether the curve is the law's; else any rising curve was far better."""
    hysteresis_kPa: CurveEstimate | None
    """None: the pairs hold no way down."""
    curve: tuple[tuple[float, float], ...]
    """Pairs [kPa, degrees] on the way up, as far as it was measured."""
    residual_deg: Array
    """What curve and hysteresis leave, pair by pair."""

    @property
    def rms_deg(self) -> float:
        return float(np.sqrt(np.mean(self.residual_deg**2)))

    @property
    def written_hysteresis_kPa(self) -> float:
        """What the configuration gets: none, where none was seen."""
        found = self.hysteresis_kPa
        return round(found.value, 2) if found and found.low > 0.0 else 0.0

    @property
    def table(self) -> str:
        """The table [vine] of the configuration."""
        pairs = ", ".join(f"[{kPa:g}, {deg:g}]" for kPa, deg in self.curve)
        return f"[vine]\ncurve = [{pairs}]\nhysteresis_kPa = {self.written_hysteresis_kPa:g}\n"

    @property
    def notes(self) -> tuple[str, ...]:
        """What a person should know before using it."""
        return tuple(_notes(self))


def fit(pairs: Pairs) -> BendCurveFit:
    """The best curve and hysteresis for measured pairs.

    Raises `PairsError` when the pairs do not say how the vine bends.
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
            f"The law leaves {found.law_rms_deg:.1f}°, a free rising curve {found.rms_deg:.1f}° (rms): "
            "curve and hysteresis are the free one's."
        )
    elif found.law.bend_max_deg > 2.0 * curve.max_deg:
        yield "The bend does not level off within what was measured: its greatest angle is a guess."
    if hysteresis is None:
        yield "No way down was measured: the hysteresis is not known, and written as 0."
    elif found.written_hysteresis_kPa == 0.0:
        yield "No hysteresis can be told from the residuals; it is written as 0."
    elif (left_deg := curve.angle_deg(hysteresis.value)) > 0.01 * curve.max_deg:
        yield f"The hysteresis is wider than the dead zone: without pressure up to {left_deg:.1f}° stay."
    if found.rms_deg > POOR * float(np.ptp(found.pairs.angle_deg)):
        yield f"{found.rms_deg:.1f}° (rms) stay unexplained: look at the picture before you use it."
    rate = found.pairs.rate_kPa_per_s
    if rate is not None and rate > SLOW_KPA_PER_S:
        yield f"The pressure moved by {rate:.1f} kPa/s: lag may count as hysteresis; measure slower."
