"""The backlash along a sequence of pressures, and the correlation of residuals: used by both fits."""

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
    bent = pressure_kPa.tolist()
    for i in range(1, len(bent)):
        bent[i] = min(max(bent[i - 1], bent[i]), bent[i] + hysteresis_kPa)
    return np.array(bent)


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
