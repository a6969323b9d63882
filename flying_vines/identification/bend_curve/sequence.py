"""What both fits share: the play along a sequence of pressures, and how much news residuals hold."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flying_vines.physics.arrays import Array


class CurveEstimate(NamedTuple):
    """A value and its 95 % interval."""

    value: float
    low: float
    high: float


class Explanation(NamedTuple):
    """A curve and a hysteresis, and what they leave of the measured angles."""

    curve: tuple[tuple[float, float], ...]
    """Pairs [kPa, degrees] on the way up, as far as it was measured."""
    hysteresis_kPa: CurveEstimate
    residual_deg: Array
    numbers: int
    """That were fitted."""

    @property
    def rms_deg(self) -> float:
        return float(np.sqrt(np.mean(self.residual_deg**2)))

    @property
    def bic(self) -> float:
        """Bayes's information criterion of independent errors: the less the better."""
        count = len(self.residual_deg)
        return count * float(np.log(np.mean(self.residual_deg**2) + 1e-12)) + self.numbers * float(
            np.log(count)
        )


def bent_kPa(pressure_kPa: Array, hysteresis_kPa: float) -> Array:
    """`BendCurve.bent_kPa` along a sequence; at the first pressure as on the way up."""
    bent = pressure_kPa.tolist()
    for i in range(1, len(bent)):
        bent[i] = min(max(bent[i - 1], bent[i]), bent[i] + hysteresis_kPa)
    return np.array(bent)


def pairs_per_news(residual: Array) -> float:
    """By how many neighbouring residuals say the same: 1 when each is independent of the one before."""
    power = float(residual @ residual)
    alike = max(0.0, float(residual[1:] @ residual[:-1]) / power) if power > 0.0 else 0.0
    return (1.0 + alike) / max(1.0 - alike, 1.0 / len(residual))


def rounded(kPa: Array, deg: Array) -> tuple[tuple[float, float], ...]:
    """Pairs for `BendCurve` that begin at 0, 0, as a person would write them; none when nothing bends."""
    pairs = [(0.0, 0.0)]
    for pressure, angle in zip(kPa.tolist(), deg.tolist(), strict=True):
        pair = (round(pressure, 2), round(max(angle, pairs[-1][1]), 2))
        if pair[0] > pairs[-1][0]:
            pairs.append(pair)
    return tuple(pairs) if pairs[-1][1] > 0.0 else ()
