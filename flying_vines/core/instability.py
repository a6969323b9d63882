"""What comes and goes: links that flap, a board that restarts again and again, a computer that is too busy.

The first loss and its end are texts at once. A condition that changes again before it has been stable for
`STABLE_AFTER_S` is unstable: then one text with the number of losses stands for all of them. If it comes and
goes slowly, the same holds from the third loss on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from flying_vines.vehicle.notice import Notice, Severity

STABLE_AFTER_S = 5.0
RESTARTS_END_AFTER_S = 10.0
"""A board that has restarted again is not cleared before it has run for this time."""
LOST_FOR_S = 1.0
"""While a condition is unstable, a loss is told when it has lasted for this time."""
BACK_FOR_S = 3.0
"""While a condition is unstable, its end is told when it has lasted for this time."""
FORGOTTEN_AFTER_S = 30.0
"""A condition without a change is remembered for this time: if it comes again, it is the next in a series."""
MAX_IN_SERIES = 3
"""From this one of a series on, it is stable only after `FORGOTTEN_AFTER_S`: it comes and goes slowly."""
COUNT_EVERY_S = 10.0
LONGEST_COUNT_EVERY_S = 60.0
"""While a condition stays unstable, the time between two counts doubles up to this."""
MAX_CONDITIONS = 64
"""Texts from outside are conditions, too. If there are more, the oldest is forgotten."""

LATE_S = 0.25
"""A tick that comes so much late counts as late: the computer is too busy."""
LATE_FOR_S = 2.0
"""After a late tick, the computer counts as busy for this time."""


@dataclass(slots=True)
class _Condition:
    began_at: float
    latest: Notice
    told: Notice
    """The latest notice that was shown."""
    told_at: float
    told_losses: int = 1
    count_every_s: float = COUNT_EVERY_S
    losses: int = 1
    in_series: int = 1

    @property
    def _is_slow(self) -> bool:
        return self.in_series >= MAX_IN_SERIES

    @property
    def back_for_s(self) -> float:
        return FORGOTTEN_AFTER_S if self._is_slow else BACK_FOR_S

    def is_stable(self, t: float) -> bool:
        return t - self.latest.t >= (FORGOTTEN_AFTER_S if self._is_slow else STABLE_AFTER_S)

    def count(self, over: bool = False) -> str:
        lasts_s = max(1, round(self.latest.t - self.began_at))
        what = f"{self.losses} losses" if self.latest.condition else f"{self.losses} times"
        unstable = "unstable: " if self.latest.condition and not over else ""
        return f"{unstable}{what} in {lasts_s} s"


class OwnLines:
    """Decides when a notice without a source is shown. Call `take` for each, and `due` at each tick."""

    def __init__(self) -> None:
        self._conditions: dict[str, _Condition] = {}

    def take(self, notice: Notice, at_once: bool = False) -> bool:
        """True if the notice is shown now; otherwise `due` may return it later. `at_once`: show it now."""
        key = notice.condition or notice.text
        condition = self._conditions.get(key)
        if condition is None or condition.is_stable(notice.t):
            before = self._conditions.pop(key, None)
            if len(self._conditions) >= MAX_CONDITIONS:
                del self._conditions[next(iter(self._conditions))]
            self._conditions[key] = new = _Condition(notice.t, notice, notice, notice.t)
            if before is not None and notice.condition:
                new.in_series = before.in_series + (not notice.ended)
            return True
        changed = notice.ended is not condition.latest.ended
        # A loss with another text is the same loss: a silent link that then comes late, for example.
        is_same = not changed and notice.text != condition.latest.text
        # How often a text came matters only if it reports a problem.
        is_same |= notice.severity > Severity.WARNING
        condition.losses += not notice.ended and not is_same
        condition.latest = notice
        if at_once or (changed and condition.losses == 1):
            condition.told, condition.told_at = notice, notice.t
            condition.told_losses = condition.losses
            return True
        return False

    def due(self, t: float) -> list[Notice]:
        """The notices to show now, each with its number of losses."""
        shown = []
        for key, condition in list(self._conditions.items()):
            latest = condition.latest
            told = condition.told.ended is latest.ended and (
                latest.ended or condition.told.text == latest.text
            )
            over = condition.is_stable(t)
            if told and condition.losses == condition.told_losses:
                if t - latest.t >= FORGOTTEN_AFTER_S:
                    del self._conditions[key]
                continue
            counts = over or t - condition.told_at >= condition.count_every_s
            settled = t - latest.t >= (condition.back_for_s if latest.ended else LOST_FOR_S)
            if not counts and (not settled or told):
                continue
            if counts:
                condition.count_every_s = min(LONGEST_COUNT_EVERY_S, 2.0 * condition.count_every_s)
            condition.told, condition.told_at, condition.told_losses = latest, t, condition.losses
            text = f"{latest.text} ({condition.count(over)})" if condition.losses > 1 else latest.text
            shown.append(replace(latest, t=t, text=text, of_decision=False))
        return shown

    def unstable(self, t: float) -> dict[str, str]:
        """A sentence for each condition that is unstable now, by its name."""
        return {
            name: f"{name} {condition.count()}"
            for name, condition in self._conditions.items()
            if condition.losses > 1 and condition.latest.condition and not condition.is_stable(t)
        }


class Restarts:
    """A series of board restarts: each comes within `RESTARTS_END_AFTER_S` of the one before."""

    def __init__(self, board: str) -> None:
        self._board = board
        self._count = 0
        self._first_at = self._last_at = -math.inf

    def note(self, t: float) -> None:
        if t - self._last_at >= RESTARTS_END_AFTER_S:
            self._count, self._first_at = 0, t
        self._count += 1
        self._last_at = t

    def looping(self, t: float) -> str:
        """The text "… restarted N times in M s"; empty if there is no series, or only one restart."""
        if self._count < 2 or t - self._last_at >= RESTARTS_END_AFTER_S:
            return ""
        lasts_s = max(1, round(self._last_at - self._first_at))
        return f"{self._board} restarted {self._count} times in {lasts_s} s"


class Lateness:
    """How late our own ticks are. If they are late, a loss may be this computer's fault.

    After a stall, messages that have waited come before the tick. So each event is checked.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._due = math.inf
        self._late_at = -math.inf
        self._worst_s = 0.0

    def note(self, t: float) -> None:
        """An event comes at `t`."""
        late_s = t - self._due
        if late_s >= LATE_S:
            self._worst_s = max(late_s, self._worst_s if self.problem(t) else 0.0)
            self._late_at = t

    def tick(self, t: float) -> None:
        self._due = t + self._period_s

    def problem(self, t: float) -> str:
        """The text "this computer is too busy: late by 340 ms"; empty if it is not."""
        if t - self._late_at > LATE_FOR_S:
            return ""
        late = f"{1000 * self._worst_s:.0f} ms" if self._worst_s < 1.0 else f"{self._worst_s:.1f} s"
        return f"this computer is too busy: late by {late}"
