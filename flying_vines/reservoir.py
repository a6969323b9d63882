"""How much air is left and how many cycles it buys.

The paper's equation for n_cycles (Eq. 8) is the starting point. It takes the CV as rigid and the Venturi as
costing as much as the inflation. A flat pouch needs several times as much air, so what a cycle really costs
is measured in use, as a multiple of the paper's cost.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from flying_vines.config import Pneumatics
from flying_vines.pneumatics import paper

PRIOR_COST = 2.2
PRIOR_COST_SD = 1.4
"""Vented passively, a rigid CV costs half of what the paper's equation says; a flat pouch up to six times."""
LEAST_COST = 0.3
CYCLES_VARY_BY = 0.15
READING_SD_KPA = 0.4
"""Of a filtered reservoir reading: 10-bit conversion and sensor noise."""
FILTER_S = 0.3
SETTLED_S = 0.6
"""After a deflation, until the filtered reservoir reading has caught up."""
NOTICED_SWING_KPA = 1.5
REFILL_KPA = 15.0
Z90 = 1.645


def n_cycles(p: Pneumatics, reservoir_kPa: float) -> float:
    """Cycles left by the paper's equation, for gauge reservoir pressure; not below 0."""
    by_paper = paper.n_cycles(
        reservoir_kPa,
        reservoir_volume_L=p.reservoir_volume_L,
        cv_volume_L=p.cv_volume_L,
        swing_kPa=p.cycle_swing_kPa,
        rate_kPa_per_s=p.cycle_rate_kPa_per_s,
        flow_resistance_kPa_s_per_SL=p.evp_flow_resistance_kPa_s_per_SL,
    )
    return max(0.0, by_paper)


def floor_kPa(p: Pneumatics, rate_kPa_per_s: float) -> float:
    """Below this gauge pressure the reservoir no longer fills a CV at `rate_kPa_per_s`."""
    return paper.least_reservoir_kPa(rate_kPa_per_s, p.evp_flow_resistance_kPa_s_per_SL, p.cv_volume_L)


def _paper_cost_kPa(p: Pneumatics) -> float:
    """What the paper's equation takes a cycle to cost: the rigid CV's air, and as much for the Venturi."""
    return 2.0 * p.cv_volume_L * p.cycle_swing_kPa / p.reservoir_volume_L


@dataclass(frozen=True, slots=True)
class CyclesLeft:
    """A prediction with its 90 % interval, and what it rests on."""

    expected: float
    low: float
    high: float
    measured_cycles: float
    """Cycles in use so far that the cost was measured on."""
    cost_kPa: float
    """What one cycle takes from the reservoir, expected."""


class ReservoirEstimate:
    """Watches both pressures and learns what a cycle costs."""

    def __init__(self, pneumatics: Pneumatics) -> None:
        self._p = pneumatics
        self._reservoir_kPa: float | None = None
        self._t = 0.0
        self._low_kPa = 0.0
        self._high_kPa = 0.0
        self._before_kPa: float | None = None
        self._vented_at: float | None = None
        self._cycles = 0.0
        self._spent_kPa = 0.0

    @property
    def reservoir_kPa(self) -> float:
        """The filtered reading; NaN before the first."""
        return math.nan if self._reservoir_kPa is None else self._reservoir_kPa

    def update(self, t: float, cv_kPa: float, reservoir_kPa: float) -> None:
        """Take in one reading of both sensors (gauge kPa)."""
        if self._reservoir_kPa is None or reservoir_kPa > self._reservoir_kPa + REFILL_KPA:
            self._reservoir_kPa = reservoir_kPa
            self._before_kPa = self._vented_at = None
        weight = 1.0 - math.exp(-max(0.0, t - self._t) / FILTER_S)
        self._reservoir_kPa += weight * (reservoir_kPa - self._reservoir_kPa)
        self._t = t
        self._follow_cycle(t, cv_kPa)

    def _follow_cycle(self, t: float, cv_kPa: float) -> None:
        assert self._reservoir_kPa is not None
        if self._before_kPa is None:
            self._low_kPa = min(self._low_kPa, cv_kPa)
            if cv_kPa > self._low_kPa + NOTICED_SWING_KPA:
                self._before_kPa = self._reservoir_kPa
                self._high_kPa = cv_kPa
            return
        if cv_kPa > self._high_kPa:
            self._high_kPa = cv_kPa
        swing_kPa = self._high_kPa - self._low_kPa
        down = cv_kPa < self._low_kPa + max(NOTICED_SWING_KPA, 0.15 * swing_kPa)
        if not down:
            if self._vented_at is not None:
                # The next inflation began before the reading had settled: both count together.
                self._cycles += swing_kPa / self._p.cycle_swing_kPa
                self._high_kPa = cv_kPa
            self._vented_at = None
        elif self._vented_at is None:
            self._vented_at = t
        elif t - self._vented_at >= SETTLED_S:
            self._cycles += swing_kPa / self._p.cycle_swing_kPa
            self._spent_kPa += self._before_kPa - self._reservoir_kPa
            self._before_kPa = self._vented_at = None
            self._low_kPa = cv_kPa

    def _cost(self) -> tuple[float, float]:
        """The cost of a cycle as a multiple of the paper's, and its standard deviation."""
        prior_weight = PRIOR_COST_SD**-2
        if self._cycles < 0.05:
            return PRIOR_COST, PRIOR_COST_SD
        paper_kPa = _paper_cost_kPa(self._p)
        seen = self._spent_kPa / (self._cycles * paper_kPa)
        reading_sd = math.sqrt(2.0) * READING_SD_KPA / (self._cycles * paper_kPa)
        scatter_sd = CYCLES_VARY_BY * max(seen, LEAST_COST) / math.sqrt(max(1.0, self._cycles))
        weight = 1.0 / (reading_sd**2 + scatter_sd**2)
        cost = (prior_weight * PRIOR_COST + weight * seen) / (prior_weight + weight)
        return max(LEAST_COST, cost), (prior_weight + weight) ** -0.5

    def spending_kPa(self, rise_kPa: float) -> float:
        """What raising the CV by `rise_kPa` in all will take from the reservoir, expected."""
        return self._cost()[0] * _paper_cost_kPa(self._p) * rise_kPa / self._p.cycle_swing_kPa

    def cycles_left(self) -> CyclesLeft | None:
        """None before the first reading."""
        if self._reservoir_kPa is None:
            return None
        by_paper = n_cycles(self._p, self._reservoir_kPa)
        cost, sd = self._cost()
        most = max(LEAST_COST, cost - Z90 * sd)
        return CyclesLeft(
            expected=by_paper / cost,
            low=by_paper / (cost + Z90 * sd),
            high=by_paper / most,
            measured_cycles=self._cycles,
            cost_kPa=cost * _paper_cost_kPa(self._p),
        )
