"""Limits the lines that requests cause on the displays, so that a flood of requests hides no fault.

Every request is answered and logged. But the displays (ground station, page, terminal, broker) show only some
lines of each source, and then a count: "refused bend 40°: not armed (23 times)". A line about the vine's own
losses and faults has no source and is never counted.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from flying_vines.vehicle.notice import Notice

MAX_LINES = 3
"""Different lines of one source that are shown in a period. All others, and repeats, are only counted."""
FIRST_PERIOD_S = 5.0
LONGEST_PERIOD_S = 60.0
"""The period doubles as long as lines are counted."""
MAX_SOURCES = 8
"""Sender ids can be forged. All further sources share the lines of one."""
OTHERS = "many senders"


@dataclass(slots=True)
class _Period:
    ends_at: float
    lasts_s: float = FIRST_PERIOD_S
    shown: set[str] = field(default_factory=set)
    total: int = 0
    first: str = ""
    mixed: bool = False
    """Not all lines had the text `first`."""
    latest: Notice | None = None
    """The latest line that was not shown."""

    def take(self, line: Notice) -> bool:
        self.total += 1
        self.first = self.first or line.text
        self.mixed |= line.text != self.first
        if line.text not in self.shown and len(self.shown) < MAX_LINES:
            self.shown.add(line.text)
            return True
        self.latest = line
        return False

    def count(self, latest: Notice, t: float, source: str) -> Notice:
        """The notice about the lines that were not shown; `latest` is the last of them."""
        text = latest.text
        if self.total > 1:
            text += f" (one of {self.total} from {source})" if self.mixed else f" ({self.total} times)"
        return replace(latest, t=t, text=text, of_decision=False)


class RequestLines:
    """Call `take` for each line with a source, and `due` at each tick."""

    def __init__(self) -> None:
        self._periods: dict[str, _Period] = {}

    def take(self, line: Notice) -> bool:
        """True if the line is shown; otherwise it is counted."""
        source = line.source
        if source not in self._periods and (len(self._periods) >= MAX_SOURCES or OTHERS in self._periods):
            source = OTHERS
        period = self._periods.setdefault(source, _Period(line.t + FIRST_PERIOD_S))
        return period.take(line)

    def due(self, t: float) -> list[Notice]:
        """The counts of the periods that are over."""
        counts = []
        for source, period in list(self._periods.items()):
            if t < period.ends_at:
                continue
            if (latest := period.latest) is None:
                del self._periods[source]
                continue
            counts.append(period.count(latest, t, source))
            lasts_s = min(LONGEST_PERIOD_S, 2.0 * period.lasts_s)
            # A line that was counted is not new in the next period.
            self._periods[source] = _Period(t + lasts_s, lasts_s, {latest.text})
        return counts
