"""A fit with some causes: its score, and whether it explains the data."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flying_vines.identification.fit import Fit, FitProblem, chi2_of
from flying_vines.identification.residuals import Pattern, excess, patterns
from flying_vines.physics.arrays import Array
from flying_vines.physics.cause import Cause, Parameter

CLAIM = 25.0
"""Minimum score gain of a cause. By chance, the best of 20 wrong causes gains 20 in 1 of 10,000 cases."""
STRUCTURE = 6.0
"""−log₁₀ p: from this value on, a pattern in the residuals is not noise."""
SURELY = 4.0
"""A cause is certain if a neutral value of one parameter raises χ² by more than this times `CLAIM`."""
SURE_SIZE = 8.0
"""From 1 + 8/√n on, χ² per reading is larger than noise explains: more than five standard deviations."""
ON_BOUND = 1e-6
"""A parameter counts as on a bound if it is nearer to the bound than this share of its range."""


@dataclass(frozen=True)
class Candidate:
    """A fit with some causes, or with none."""

    problem: FitProblem
    fit: Fit

    @property
    def causes(self) -> tuple[Cause, ...]:
        return self.fit.point.causes

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(cause.name for cause in self.causes)

    def doubtful(self) -> list[int]:
        """Indices of the causes that are not certain (`SURELY`): all their parameters may be neutral.

        The rise of χ² at a neutral value is estimated from the curvature of χ² at the fit.
        """
        found = []
        spread = max(self.excess) * np.diag(self.covariance)
        for index, (cause, values) in enumerate(zip(self.causes, self.fit.point.values, strict=True)):
            variances = spread[self.columns(index)]
            sure = (
                parameter.distance(value) ** 2 > SURELY * CLAIM * variance
                for parameter, value, variance in zip(cause.parameters, values, variances, strict=True)
            )
            if not any(sure):
                found.append(index)
        return found

    def in_units_of(self, problem: FitProblem) -> Candidate:
        """The same fit, in units of the noise of another problem with the same data."""
        ratio = np.array(self.problem.noise_kPa)[:, None] / np.array(problem.noise_kPa)[:, None]
        residuals = tuple(r * ratio for r in self.fit.residuals)
        chi2 = chi2_of(residuals)
        prior = self.fit.cost - self.fit.chi2
        return Candidate(problem, Fit(self.fit.point, chi2, chi2 + prior, residuals))

    @cached_property
    def covariance(self) -> Array:
        """See `FitProblem.covariance`."""
        return self.problem.covariance(self.fit)

    def columns(self, index: int) -> range:
        """Columns of the covariance that belong to the parameters of the cause `index`."""
        first = len(self.fit.point.deviation) + sum(len(c.parameters) for c in self.causes[:index])
        return range(first, first + len(self.causes[index].parameters))

    @property
    def score(self) -> float:
        """The score if the residuals of the best fit are noise; see `score_at`."""
        return self.score_at((1.0, 1.0))

    def score_at(self, excess: tuple[float, float]) -> float:
        """−2 ln of the evidence, up to a constant.

        χ², plus the penalty of free rig numbers, plus ln(number of readings) for each parameter (BIC).

        Args:
            excess: for control volume and reservoir, the excess of the residuals over noise. It divides χ².
        """
        parameters = sum(len(cause.parameters) for cause in self.causes)
        chi2 = sum(chi2 / over for chi2, over in zip(self.channels, excess, strict=True))
        return chi2 + self.freedom + parameters * float(np.log(self.problem.readings))

    @cached_property
    def channels(self) -> tuple[float, float]:
        """χ² of control volume and reservoir."""
        cv, reservoir = (sum(float(r[row] @ r[row]) for r in self.fit.residuals) for row in (0, 1))
        return cv, reservoir

    @property
    def on_bound(self) -> tuple[str, ...]:
        """Parameters on a bound of their physical range."""
        return tuple(parameter.name for _, parameter in self._bounded())

    @property
    def causes_on_bound(self) -> list[int]:
        """Indices of the causes with a parameter on a bound; parameters with a prior do not count."""
        return sorted({index for index, parameter in self._bounded() if parameter.typical is None})

    @property
    def within_bounds(self) -> bool:
        """False if a cause is one of `causes_on_bound`: no real rig has such a cause."""
        return not self.causes_on_bound

    def _bounded(self) -> Iterator[tuple[int, Parameter]]:
        point = self.fit.point
        for index, (cause, values) in enumerate(zip(point.causes, point.values, strict=True)):
            for parameter, value in zip(cause.parameters, values, strict=True):
                if not ON_BOUND < parameter.share(value) < 1.0 - ON_BOUND:
                    yield index, parameter

    @cached_property
    def freedom(self) -> float:
        """Penalty of the free rig numbers: −2 ln (prior density at the fit · posterior width), by Laplace."""
        deviation = self.fit.point.deviation
        if not deviation:
            return 0.0
        precision = np.array([self.problem.prior_std(key) ** -2.0 for key in deviation])
        moved = float(precision @ np.array(list(deviation.values())) ** 2)
        k = len(deviation)
        posterior = self.covariance[:k, :k]
        _, log_posterior = np.linalg.slogdet(posterior)
        return moved - float(log_posterior + np.log(precision).sum())

    @cached_property
    def patterns(self) -> list[Pattern]:
        return patterns(self.problem, self.fit)

    @property
    def adequate(self) -> bool:
        """True if the residuals are noise."""
        return not self.patterns or self.patterns[0].log_p < STRUCTURE

    @cached_property
    def excess(self) -> tuple[float, float]:
        """Excess of the residuals over noise, for control volume and reservoir; 1 if they are noise.

        Rounded readings can hide a pattern, so the size of the residuals counts as well.
        """
        cv, reservoir = (1.0, 1.0) if self.adequate else excess(self.patterns)
        cv_size, reservoir_size = self._sizes
        return max(cv, cv_size), max(reservoir, reservoir_size)

    @property
    def _sizes(self) -> tuple[float, float]:
        """Mean square of the residuals over that of noise, for control volume and reservoir.

        A ratio that noise alone can give is set to 1.
        """
        sizes = []
        for row, (chi2, noise) in enumerate(zip(self.channels, self.problem.noise, strict=True)):
            count = sum(int(np.count_nonzero(weight[row])) for weight in self.problem.weights)
            size = chi2 / (count * noise.variance_over_slow) if count else 1.0
            sizes.append(size if size > 1.0 + SURE_SIZE / np.sqrt(max(count, 1)) else 1.0)
        return sizes[0], sizes[1]
