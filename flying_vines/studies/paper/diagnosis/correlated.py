"""A fit problem with few readings and correlated noise.

The fit minimises sums of squared residuals. Correlated residuals are multiplied by the inverse of a Cholesky
factor of their covariance, so they become independent with variance 1. Only the reservoir's readings are
used: a discharge has no others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import solve_triangular

from flying_vines.identification.case import Case
from flying_vines.identification.fit import Bools, FitPoint, FitProblem
from flying_vines.identification.noise import independent_noise
from flying_vines.physics.arrays import Array
from flying_vines.studies.paper.diagnosis.evidence import Linear, Noise, UnexplainedLevel

RESERVOIR = 1
"""Row of the reservoir in a run's readings."""
START_SD_KPA = 50.0
"""Prior standard deviation of an initial pressure about its first reading; so large that it has no effect."""
_NUDGE = 1e-3
_NUDGE_KPA = 0.1


class Correlated(FitProblem):
    """A case of discharges with independent residuals, in standard deviations.

    Args:
        noise: noise and model error of the readings.
        level: its level.
        used: as in `FitProblem`; default: all readings.
    """

    def __init__(
        self, case: Case, noise: Noise, level: UnexplainedLevel, used: Sequence[Bools] | None = None
    ) -> None:
        super().__init__(case, independent_noise(1.0, 1.0), used)
        self.correlated = noise
        self.level = level
        self.after_s = [run.time_s - run.time_s[0] for run in case.runs]
        self.scaled = [self._scaled(index) for index in range(len(case.runs))]
        self._kept = [weight[RESERVOIR] > 0.0 for weight in self.weights]
        self._factors = [
            np.linalg.cholesky(noise.covariance([level], x[kept], s[kept])[0])
            for x, s, kept in zip(self.after_s, self.scaled, self._kept, strict=True)
        ]

    def residuals(self, point: FitPoint, runs: Sequence[int] | None = None) -> list[Array]:
        """Independent residuals of these runs (default: all), (2, n) as in `Fit`."""
        every = range(len(self.data)) if runs is None else runs
        found = []
        for i, left in zip(every, super().residuals(point, runs), strict=True):
            kept = self._kept[i]
            white = np.zeros_like(left)
            white[RESERVOIR, kept] = solve_triangular(self._factors[i], left[RESERVOIR, kept], lower=True)
            found.append(white)
        return found

    def pressures_kPa(self, point: FitPoint) -> Array:
        """Simulated readings of the reservoir's sensor, run after run."""
        return np.concatenate([readings[RESERVOIR] for readings in self.simulated(point)])

    def linear(self, point: FitPoint) -> Linear:
        """The model linearised at a point: free rig numbers, parameters of causes, initial pressures."""
        here = self.pressures_kPa(point)
        measured = np.concatenate([data[RESERVOIR] for data in self.data])
        traces, away, spread = [], [], []
        for key, share in point.deviation.items():
            moved = {**point.deviation, key: share + _NUDGE}
            traces.append((self.pressures_kPa(replace(point, deviation=moved)) - here) / _NUDGE)
            away.append(share)
            spread.append(self.prior_std(key))
        for i, (cause, values) in enumerate(zip(point.causes, point.values, strict=True)):
            for j, parameter in enumerate(cause.parameters):
                if parameter.typical is None:
                    raise ValueError(f"{cause.name}: {parameter.name} needs a typical value")
                mean, sd = parameter.typical
                searched = parameter.to_search(values[j])
                nudge = _NUDGE * sd
                if parameter.to_model(searched + nudge) > parameter.high:
                    nudge = -nudge
                changed = list(values)
                changed[j] = parameter.to_model(searched + nudge)
                every = list(point.values)
                every[i] = tuple(changed)
                traces.append((self.pressures_kPa(replace(point, values=tuple(every))) - here) / nudge)
                away.append(searched - mean)
                spread.append(sd)
        for k, first in enumerate(self.start().initial[:, 0]):
            initial = point.initial.copy()
            initial[k, 0] += _NUDGE_KPA
            traces.append((self.pressures_kPa(replace(point, initial=initial)) - here) / _NUDGE_KPA)
            away.append(point.initial[k, 0] - first)
            spread.append(START_SD_KPA)
        return Linear(
            series=tuple(self.after_s),
            scaled=tuple(self.scaled),
            residual=measured - here,
            traces=np.stack(traces, axis=1),
            away=np.array(away),
            spread=np.array(spread),
        )

    def _scaled(self, index: int) -> Array:
        """Derivative of a run by the logarithm of its flow, for an exponential with the run's mean rate."""
        time_s, kPa = self.after_s[index], self.data[index][RESERVOIR]
        rate_per_s = np.log(kPa[0] / kPa[-1]) / time_s[-1]
        return np.asarray(-kPa[0] * rate_per_s * time_s * np.exp(-rate_per_s * time_s))
