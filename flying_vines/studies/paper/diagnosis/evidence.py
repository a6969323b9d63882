"""Marginal likelihood of a model with few, correlated readings.

Every model of a real rig is incomplete, and its errors are correlated from reading to reading. So a reading
is the model's value, plus independent rounding, plus a discrepancy δ along the series (after Kennedy &
O'Hagan 2001), plus a difference between series of the same set-up. δ is a Gaussian process with

    cov(δ(x), δ(x')) = s² [k(|x − x'|) − k(x) k(x')],   k(d) = exp(−d/ℓ), or exp(−d²/2ℓ²)

which is 0 at x = 0 (`from_start`: the model starts at the first reading); otherwise with cov = s² k(|x −
x'|). The sizes of s, ℓ and of the difference between series are unknown. So the likelihood is averaged over a
grid of them that is uniform in their logarithms. The parameters are averaged over their priors, with the
model linearised at its best fit (Laplace). So a model with more freedom gets a penalty, and a small
improvement that δ could also give counts little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from flying_vines.physics.arrays import Array


class UnexplainedLevel(NamedTuple):
    """Level of the unexplained error, in the units of the readings and of x."""

    discrepancy: float
    length: float
    between_series: float
    """Standard deviation of the logarithm of each series' scale factor."""


@dataclass(frozen=True)
class Noise:
    """Noise and model error of the readings."""

    rounding: float
    """Standard deviation of the independent error of a reading."""
    discrepancies: tuple[float, ...]
    lengths: tuple[float, ...]
    between_series: tuple[float, ...]
    from_start: bool = True
    smooth: bool = False
    """True for the Gaussian kernel, False for the exponential one."""

    def levels(self) -> list[UnexplainedLevel]:
        """All levels of the grid, with equal prior probability."""
        return [
            UnexplainedLevel(*each) for each in product(self.discrepancies, self.lengths, self.between_series)
        ]

    def covariance(self, levels: Sequence[UnexplainedLevel], x: Array, scaled: Array) -> Array:
        """Covariance of the readings of one series, (levels, n, n).

        Args:
            levels: levels of the unexplained error.
            x: (n,) positions of the readings.
            scaled: (n,) derivatives of the readings by the logarithm of the series' scale factor.
        """
        each = np.array(levels)[:, :, None, None]
        discrepancy, length, between_series = each[:, 0], each[:, 1], each[:, 2]
        total = self._kernel(np.abs(x[:, None] - x[None, :]) / length)
        if self.from_start:
            own = self._kernel(x / length)
            total = total - own * own.transpose(0, 2, 1)
        total = discrepancy**2 * total + between_series**2 * np.outer(scaled, scaled)
        return np.asarray(total + self.rounding**2 * np.eye(len(x)))

    def _kernel(self, distance: Array) -> Array:
        return np.asarray(np.exp(-0.5 * distance**2 if self.smooth else -distance))


@dataclass(frozen=True)
class Linear:
    """A model linearised at its best fit, and the readings."""

    series: tuple[Array, ...]
    """x of each series."""
    scaled: tuple[Array, ...]
    """See `Noise.covariance`."""
    residual: Array
    """(n,) measured minus modelled, series after series."""
    traces: Array
    """(n, k) derivatives of the model by the parameters."""
    away: Array
    """(k,) best fit minus prior mean."""
    spread: Array
    """(k,) prior standard deviations."""


class Worth(NamedTuple):
    """The evidence for a model, and its parameters."""

    minus_2_ln: float
    """−2 ln of the marginal likelihood."""
    level: UnexplainedLevel
    """The most likely level."""
    shift: Array
    """(k,) posterior mean minus linearisation point, averaged over all levels."""
    sd: Array
    """(k,) posterior standard deviations."""


def worth(noise: Noise, model: Linear) -> Worth:
    """The marginal likelihood of the readings under a model, and the posterior of its parameters."""
    levels = noise.levels()
    # Relative to the prior means, in prior standard deviations.
    expected = model.residual + model.traces @ model.away
    columns = np.column_stack((expected, model.traces * model.spread))
    gram = np.zeros((len(levels), columns.shape[1], columns.shape[1]))
    logarithm = np.full(len(levels), len(expected) * np.log(2.0 * np.pi))
    at = 0
    for x, scaled in zip(model.series, model.scaled, strict=True):
        part = columns[at : at + len(x)]
        covariance = noise.covariance(levels, x, scaled)
        gram += part.T @ np.linalg.solve(covariance, np.broadcast_to(part, (len(levels), *part.shape)))
        logarithm += np.linalg.slogdet(covariance)[1]
        at += len(x)
    slope = gram[:, 1:, 0]
    information = np.eye(slope.shape[1]) + gram[:, 1:, 1:]
    inverse = np.linalg.inv(information)
    moved = np.einsum("lij,lj->li", inverse, slope)
    heights = (
        gram[:, 0, 0] - np.einsum("li,li->l", slope, moved) + logarithm + np.linalg.slogdet(information)[1]
    )
    best = int(np.argmin(heights))
    weights = np.exp(-0.5 * (heights - heights[best]))
    averaged = float(heights[best] - 2.0 * np.log(np.mean(weights)))
    weights /= weights.sum()
    shifts = moved * model.spread - model.away
    variances = np.einsum("lii->li", inverse) * model.spread**2
    shift = weights @ shifts
    variance = weights @ (variances + (shifts - shift) ** 2)
    return Worth(averaged, levels[best], shift, np.sqrt(variance))
