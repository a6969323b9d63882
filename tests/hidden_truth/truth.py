"""What is hidden, in which rig, what is believed of it, how it is flown, and what is lost of the record."""

from __future__ import annotations

from dataclasses import dataclass

from hidden_truth.effects import Hidden, with_effects
from hidden_truth.kernel import Physics
from hidden_truth.plans import Plan
from hidden_truth.rig import Noise, Rig


@dataclass(frozen=True, eq=False)
class Truth:
    """Everything that a case follows from.

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
    """The one that explains most first."""
    rig: Rig
    believed: Rig
    tolerance_percent: float
    noise: Noise
    stated: Noise
    plans: tuple[Plan, ...]
    stream: tuple[int, ...]
    """Of random numbers: for the noise, and what is lost."""
    gap: float = 0.0
    """How far the chi-square of the baseline's best fit lies above the truth's, on the data as recorded."""

    @property
    def physics(self) -> Physics:
        return with_effects(self.rig, self.hidden)
