"""What a model of few, correlated readings is worth: its marginal likelihood, with what no model has in it.

Every model of a real rig leaves something out, and what it leaves out is alike from reading to reading. So a
reading is the model's, plus rounding (independent), plus a discrepancy δ along the series (after Kennedy &
O'Hagan 2001), plus what differs between series of the same set-up. δ is a Gaussian process with

    cov(δ(x), δ(x')) = s² [k(|x − x'|) − k(x) k(x')],   k(d) = exp(−d/ℓ), or exp(−d²/2ℓ²),

which is 0 at x = 0, for a model begins where the series begins (`from_start`), or else s² k(|x − x'|). How
large s, ℓ and the difference between series are is unknown: the likelihood is averaged over a grid of them,
equally likely along their logarithms. The parameters are averaged over their priors, with the model taken as
linear about its best fit (Laplace). So a model with more freedom pays for it, and one that leaves a little
less, where δ might as well have been there, gains little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from flying_vines.physics.arrays import Array


class UnexplainedLevel(NamedTuple):
    """How much no model explains, in the unit of the readings and of x."""

    discrepancy: float
    length: float
    between_series: float
    """Standard deviation of the logarithm of what scales each series."""


@dataclass(frozen=True)
class Noise:
    """What may be in the readings beside the model."""

    rounding: float
    """Standard deviation of a reading by itself."""
    discrepancies: tuple[float, ...]
    lengths: tuple[float, ...]
    between_series: tuple[float, ...]
    from_start: bool = True
    smooth: bool = False
    """The Gaussian kernel instead of the exponential one."""

    def levels(self) -> list[UnexplainedLevel]:
        """All that are equally likely before any data."""
        return [
            UnexplainedLevel(*each) for each in product(self.discrepancies, self.lengths, self.between_series)
        ]

    def covariance(self, levels: Sequence[UnexplainedLevel], x: Array, scaled: Array) -> Array:
        """Of the readings of one series, (levels, n, n).

        Args:
            levels: how much no model explains.
            x: (n,) where the readings are.
            scaled: (n,) their derivative by the logarithm of what scales the series.
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
    """A model about its best fit, and the readings."""

    series: tuple[Array, ...]
    """x of each series."""
    scaled: tuple[Array, ...]
    """As in `Noise.covariance`."""
    residual: Array
    """(n,) measured less modelled, series after series."""
    traces: Array
    """(n, k) derivatives of what is modelled by the parameters."""
    away: Array
    """(k,) how far the best fit is from what was expected …"""
    spread: Array
    """… and the standard deviation of that."""


class Worth(NamedTuple):
    """What the readings say of a model."""

    minus_2_ln: float
    """Of the marginal likelihood."""
    level: UnexplainedLevel
    """The likeliest."""
    shift: Array
    """(k,) by how much the parameters differ from where the model was linearised, over all levels …"""
    sd: Array
    """… and how well they are known then."""


def worth(noise: Noise, model: Linear) -> Worth:
    """The marginal likelihood of the readings under a model, and what they say of its parameters."""
    levels = noise.levels()
    # In units of what was expected of each parameter, and from there.
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
    likeliest = int(np.argmin(heights))
    weights = np.exp(-0.5 * (heights - heights[likeliest]))
    averaged = float(heights[likeliest] - 2.0 * np.log(np.mean(weights)))
    weights /= weights.sum()
    shifts = moved * model.spread - model.away
    variances = np.einsum("lii->li", inverse) * model.spread**2
    shift = weights @ shifts
    variance = weights @ (variances + (shifts - shift) ** 2)
    return Worth(averaged, levels[likeliest], shift, np.sqrt(variance))
