"""A case whose readings are few and whose noise is correlated, in the engine's own terms.

The engine minimises sums of squared residuals. Multiplied by the inverse of a Cholesky factor of their
covariance, correlated residuals become independent ones of variance 1, and everything that the engine does
with residuals holds for them. Only the reservoir's readings are looked at: a discharge has no others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import solve_triangular

from flying_vines.identification.case import Case
from flying_vines.identification.fit import Bools, FitPoint, FitProblem
from flying_vines.physics.arrays import Array
from flying_vines.studies.paper.diagnosis.evidence import Linear, Noise, UnexplainedLevel

RESERVOIR = 1
"""The row of a run's readings."""
START_SD_KPA = 50.0
"""Of what is expected of a pressure at the start, about its first reading: any."""
_NUDGE = 1e-3
_NUDGE_KPA = 0.1


class Correlated(FitProblem):
    """A case of discharges; residuals are in units of their standard deviations and independent.

    Args:
        case: the data.
        noise: what may be in the readings beside the model.
        level: how much of it.
        used: as the engine has it; all readings if not given.
    """

    def __init__(
        self, case: Case, noise: Noise, level: UnexplainedLevel, used: Sequence[Bools] | None = None
    ) -> None:
        super().__init__(case, (1.0, 1.0), used)
        self.noise = noise
        self.level = level
        self.after_s = [run.time_s - run.time_s[0] for run in case.runs]
        self.scaled = [self._scaled(index) for index in range(len(case.runs))]
        self._kept = [weight[RESERVOIR] > 0.0 for weight in self.weights]
        self._factors = [
            np.linalg.cholesky(noise.covariance([level], x[kept], s[kept])[0])
            for x, s, kept in zip(self.after_s, self.scaled, self._kept, strict=True)
        ]

    def residuals(self, point: FitPoint, runs: Sequence[int] | None = None) -> list[Array]:
        """Of these runs (all if not given): (2, n) as in `Fit`, independent."""
        every = range(len(self.data)) if runs is None else runs
        found = []
        for i, left in zip(every, super().residuals(point, runs), strict=True):
            kept = self._kept[i]
            white = np.zeros_like(left)
            white[RESERVOIR, kept] = solve_triangular(self._factors[i], left[RESERVOIR, kept], lower=True)
            found.append(white)
        return found

    def pressures_kPa(self, point: FitPoint) -> Array:
        """What the reservoir's sensor would have read, run after run."""
        return np.concatenate([readings[RESERVOIR] for readings in self.simulated(point)])

    def linear(self, point: FitPoint) -> Linear:
        """The model about a place: believed numbers that are free, causes' parameters, pressures at the
        start."""
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
        """Derivative of a run by the logarithm of its flow: of an exponential with the run's mean rate."""
        time_s, kPa = self.after_s[index], self.data[index][RESERVOIR]
        rate_per_s = np.log(kPa[0] / kPa[-1]) / time_s[-1]
        return np.asarray(-kPa[0] * rate_per_s * time_s * np.exp(-rate_per_s * time_s))
