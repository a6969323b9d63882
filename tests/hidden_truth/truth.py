"""The truth of a case: hidden effects, rig, nominal rig, runs, and lost data."""

from __future__ import annotations

from dataclasses import dataclass

from hidden_truth.effects import Hidden, with_effects
from hidden_truth.kernel import Physics
from hidden_truth.plans import Plan
from hidden_truth.rig import Noise, Rig


@dataclass(frozen=True, eq=False)
class Truth:
    """Everything that determines a case.

    `variant` says what is special about the case within its tier:
    `cells` (5 % of the cells of either pressure and 2 s of both are empty), `held` (rows are missing:
    single ones at random at which nothing was moved, and 2 s during which the host hung and the inputs
    stood still: what the files' rule says of them is true), `lost` (the same rows are missing for the
    record only: the rig was flown on, and the rule misleads), `uneven`, `discharge`, `noise` (stated
    wrongly), `without_…` (a column).
    """

    tier: str
    seed: int
    variant: str
    hidden: tuple[Hidden, ...]
    """The effect that explains most is first."""
    rig: Rig
    believed: Rig
    tolerance_percent: float
    noise: Noise
    stated: Noise
    plans: tuple[Plan, ...]
    stream: tuple[int, ...]
    """Seed of the random numbers for noise and lost data."""
    gap: float = 0.0
    """Chi-square of the baseline's best fit minus that of the truth, on the recorded data."""

    @property
    def physics(self) -> Physics:
        return with_effects(self.rig, self.hidden)
