"""A prediction of the cycles left, with the true number, and the errors over many rigs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean, median

from flying_vines.config.config import PneumaticsConfig
from flying_vines.physics import paper
from flying_vines.supply import CyclesLeft


@dataclass(frozen=True)
class Guess:
    """The prediction at one moment, and the truth."""

    truth: float
    estimate: CyclesLeft
    formula: float

    @property
    def error(self) -> float:
        return self.estimate.expected / self.truth - 1.0

    @property
    def formula_error(self) -> float:
        return self.formula / self.truth - 1.0

    @property
    def held(self) -> bool:
        return self.estimate.low <= self.truth <= self.estimate.high


def by_paper(p: PneumaticsConfig, reservoir_kPa: float) -> float:
    """Cycles left by the paper's Eq. 8, for gauge reservoir pressure; not below 0."""
    cycles = paper.n_cycles(
        reservoir_kPa,
        reservoir_volume_L=p.reservoir_volume_L,
        cv_volume_L=p.cv_volume_L,
        swing_kPa=p.cycle_swing_kPa,
        rate_kPa_per_s=p.cycle_rate_kPa_per_s,
        flow_resistance_kPa_s_per_SL=p.evp_flow_resistance_kPa_s_per_SL,
    )
    return max(0.0, cycles)


def quantity(guesses: Sequence[Guess], errors: Sequence[float]) -> list[str]:
    """The numbers of one row: errors relative to the truth."""
    sizes = [abs(error) for error in errors]
    return [
        str(len(guesses)),
        f"{median(sizes):.1%}",
        f"{median(errors):+.1%}",
        f"{fmean(size <= 0.15 for size in sizes):.1%}",
        f"{fmean(size <= 0.07 for size in sizes):.1%}",
    ]
