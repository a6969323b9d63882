"""The cycles left that people see: a new interval overlaps the earlier ones, unless an event is reported.

All intervals are compared as the cycles of a whole filling: the cycles left plus those whose air is gone. So
flying changes none of them. If a new interval does not overlap those of the last `WINDOW_S`, then either
something has happened (an event, with a sentence), or the earlier intervals were too narrow. In the second
case the new interval is widened until it touches them.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

from flying_vines.supply.cycles_left import Basis, CyclesLeft, ReservoirEstimate
from flying_vines.supply.reservoir_filter import CV_LEAK, LEAK, X

WINDOW_S = 120.0
SETTLED_S = 10.0
"""Jumps of the pressure within this time of each other are one refill or one loss.

They are reported once, unless the number of cycles jumps again. In this time no other reason is reported.
"""
NONE_LEFT = 0.5
"""Fewer cycles are reported as 0."""
LEAKS = "the leak has changed"
RHYTHM = "another rhythm"
BENDS = "another kind of bend"


@dataclass(frozen=True, slots=True)
class _Reported:
    t: float
    low: float
    """Cycles of the whole filling. Minus infinity if 0 was reported: the missing air is unknown."""
    high: float
    basis: Basis


def surely_left(left: CyclesLeft) -> float:
    """The low end. Minus infinity if it is reported as 0, because 0 does not say how much air is missing."""
    return left.low if left.low >= NONE_LEFT else -math.inf


class ReportedCycles:
    """Call `update` for each prediction. `left` is the number to show."""

    def __init__(self, estimate: ReservoirEstimate) -> None:
        self._estimate = estimate
        self.left: CyclesLeft | None = None
        """None before the first reading."""
        self._reported: deque[_Reported] = deque()
        self._gone = 0.0
        """Cycles whose air is gone."""
        self._x_kPa = math.nan
        self._jump_at = -math.inf
        self._from_before = estimate.measured_cycles > 0.0
        """An earlier run has learned this rig, and may have reported another number just before."""
        self.lost = False
        self.in_doubt = False

    def update(self, t: float, lost: bool, in_doubt: bool = False, armed: bool = False) -> str:
        """Predict. Returns the event as text; empty if none.

        `lost`: a fault that loses air is latched. `in_doubt`: the reservoir's sensor is wrong. `armed`: a
        rise is no refill.
        """
        if self.lost and not lost:
            # Somebody has repaired the rig: the air of a bend and the leaks are unknown again.
            self.lost = self._from_before = False
            self.left = None
            self._estimate.restart()
            return "cycles left are learned again"
        self.lost = lost
        was_in_doubt, self.in_doubt = self.in_doubt, in_doubt
        if in_doubt and not lost:
            if self._estimate.filter is not None:
                self._estimate.filter.jumped_kPa = 0.0
            self._forget()
            self.left = None
            return ""
        if was_in_doubt and not in_doubt:
            # The wrong readings have taught a wrong use of air.
            self._from_before = False
            self._forget()
            self.left = None
            self._estimate.restart()
            return "reservoir sensor is believed again, cycles left are learned again"
        new, basis, air = self._estimate.cycles_left(), self._estimate.basis, self._estimate.filter
        if new is None or basis is None or air is None:
            self.left = None
            return ""
        jumped_kPa, air.jumped_kPa = air.jumped_kPa, 0.0
        if lost:
            self._forget()
            zero = dict.fromkeys(("expected", "low", "high", "minutes", "minutes_low", "minutes_high"), 0.0)
            self.left = replace(new, lost=True, **zero)
            return ""
        if self._from_before:
            self._from_before = False
            self._compare(t, new, basis)
            return f"as learned before: {new}"
        if jumped_kPa and self._is_reported(t, new):
            self._forget()
            self._compare(t, new, basis)
            refilled = "reservoir pressure rose" if armed else "reservoir refilled"
            return f"{refilled if jumped_kPa > 0.0 else 'reservoir lost air at once'}, {new}"
        return self._compare(t, new, basis)

    def _forget(self) -> None:
        self._reported.clear()
        self._x_kPa = math.nan

    def _is_reported(self, t: float, new: CyclesLeft) -> bool:
        """True for the first of several jumps, and for a jump that moved the number out of its interval."""
        settled = t - self._jump_at > SETTLED_S
        self._jump_at = t
        before = self.left
        return settled or before is None or new.high < before.low or new.low > before.high

    def _compare(self, t: float, new: CyclesLeft, basis: Basis) -> str:
        if not math.isnan(self._x_kPa):
            self._gone += (self._x_kPa - basis.mean[X]) / new.cost_kPa
        self._x_kPa = basis.mean[X]
        while self._reported and self._reported[0].t < t - WINDOW_S:
            self._reported.popleft()
        event = ""
        if self._reported:
            low = max(self._reported, key=lambda reported: reported.low)
            high = min(self._reported, key=lambda reported: reported.high)
            least, most = low.low - self._gone, high.high - self._gone
            conflict = low if new.high < least else high if surely_left(new) > most else None
            if conflict is not None:
                # Shortly after a jump the numbers are too uncertain to report another reason.
                event = self._reason(conflict.basis, basis) if t - self._jump_at > SETTLED_S else ""
                if event:
                    self._reported.clear()
                    event = f"{event}: {new}"
                else:
                    new = replace(new, low=max(0.0, min(new.low, most)), high=max(new.high, least))
        self.left = new
        self._reported.append(_Reported(t, surely_left(new) + self._gone, new.high + self._gone, basis))
        return event

    def _reason(self, before: Basis, now: Basis) -> str:
        """The change of rig or flying that moved the prediction most; empty if new data moved it most."""
        mean = list(now.mean)
        mean[LEAK], mean[CV_LEAK] = before.mean[LEAK], before.mean[CV_LEAK]
        time_s = before.cycle.spent.time_s
        rhythm = now.cycle._replace(spent=now.cycle.spent._replace(time_s=time_s))
        bends = before.cycle._replace(spent=before.cycle.spent._replace(time_s=now.cycle.spent.time_s))
        known = [*before.mean]
        for i in (X, LEAK, CV_LEAK):
            known[i] = now.mean[i]
        shares = {
            LEAKS: self._moved(now, now._replace(mean=mean)),
            RHYTHM: self._moved(now, now._replace(cycle=rhythm)),
            BENDS: self._moved(now, now._replace(cycle=bends, floor_kPa=before.floor_kPa)),
            "": self._moved(now, now._replace(mean=known)),
        }
        return max(shares, key=lambda name: shares[name])

    def _moved(self, now: Basis, other: Basis) -> float:
        return abs(math.log(self._estimate.cycles_of(now) / self._estimate.cycles_of(other)))
