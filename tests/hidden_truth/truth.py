"""The truth of a case: hidden effects, rig, nominal rig, runs, and lost data."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hidden_truth.effects import Hidden, with_effects
from hidden_truth.kernel import Physics
from hidden_truth.plans import PERIOD_S, Plan
from hidden_truth.rig import Noise, Rig


@dataclass(frozen=True, eq=False)
class Truth:
    """Everything that determines a case.

    `variant` is the special property of the case within its tier:

    - `cells`: 5 % of the cells of either pressure, and 2 s of both, are empty;
    - `held`: rows are missing: single random ones without a change of the inputs, and 2 s in which the host
      hung. The inputs were constant meanwhile, as the file format promises for missing rows;
    - `lost`: as many rows are missing, but only from the record. The inputs continued to change, so this
      promise is broken;
    - `uneven`, `discharge`, `noise` (stated wrongly), `without_…` (a column), `rounded` (by a converter),
      `correlated` (noise).
    """

    tier: str
    seed: int
    variant: str
    hidden: tuple[Hidden, ...]
    """The effect with the largest share is the first one."""
    rig: Rig
    assumed: Rig
    tolerance_percent: float
    noise: Noise
    stated: Noise
    plans: tuple[Plan, ...]
    stream: tuple[int, ...]
    """Seed of the random numbers for noise and lost data."""
    gap: float = 0.0
    """Chi-square of the baseline's best fit minus that of the truth, on the recorded data."""
    shares: tuple[float, ...] = ()
    """For each hidden effect: the share of `gap` that comes back without it, after a fit of the other
    effects, whose strengths may change within `gap.KNOWN`."""
    converter_step: float = 0.0
    """Step of both converters in standard deviations of the noise; 0: as fine as the files."""
    correlation_s: float = 0.0
    """Correlation time of the noise, first-order autoregressive; 0: white."""

    @property
    def independent_share(self) -> float:
        """Information in a reading, relative to a reading with white noise and without rounding."""
        rounding = 1.0 / (1.0 + self.converter_step**2 / 12.0)
        if self.correlation_s == 0.0:
            return rounding
        repeated = math.exp(-PERIOD_S / self.correlation_s)
        return rounding * (1.0 - repeated) / (1.0 + repeated)

    @property
    def physics(self) -> Physics:
        return with_effects(self.rig, self.hidden)
