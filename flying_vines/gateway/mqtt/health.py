"""State of the broker connection: reports for the crew, and the wait before a new try. It reads no clock."""

from __future__ import annotations

from typing import NamedTuple

FIRST_WAIT_S, MAX_WAIT_S = 1.0, 60.0
FIRST_WAIT_REFUSED_S, MAX_WAIT_REFUSED_S = 15.0, 300.0
"""Longer waits, because a person must change something first."""
REPORT_AFTER_S = 5.0
"""Shorter interruptions are not reported; they lose no events."""
STABLE_S = 3.0
"""A connection that has lasted this long is stable."""
SHORT_LIVED = 3
"""After this number of unstable connections in a row, another client with our id is suspected."""


class BrokerProblem(NamedTuple):
    """Why there is no connection, and True if a person must act."""

    text: str
    needs_person: bool = False


THROWN_OUT = BrokerProblem(
    "it accepts us and then closes: does another vehicle have the same mqtt.name?", needs_person=True
)
"""Some brokers do not report that another client has our client id."""


class Health:
    """The health of the connection to one broker; the first try is at `t`."""

    def __init__(self, t: float, broker: str) -> None:
        self._broker = broker
        self._connected_at: float | None = None
        self._lost_at = t
        self._problem: BrokerProblem | None = None
        self._reported: BrokerProblem | None = None
        self._failures = 0
        self._short_lived = 0

    @property
    def is_connected(self) -> bool:
        """True until `failed` is called."""
        return self._connected_at is not None

    def connected(self, t: float) -> None:
        self._connected_at = t

    def lasts(self, t: float) -> str | None:
        """The connection still exists. Returns a report, or None."""
        if self._reported is None or not self._is_stable(t):
            return None
        self._reported = None
        return f"MQTT: {self._broker} is back"

    def failed(self, t: float, problem: BrokerProblem) -> str | None:
        """A try failed, or a connection ended. Returns a report, or None."""
        if self._is_stable(t):
            self._failures = self._short_lived = 0
            self._lost_at = t
        elif self.is_connected:
            self._short_lived += 1
            if self._short_lived >= SHORT_LIVED and not problem.needs_person:
                problem = THROWN_OUT
        self._connected_at = None
        self._failures += 1
        self._problem = problem
        lasting = problem.needs_person or t - self._lost_at >= REPORT_AFTER_S
        if not lasting or problem == self._reported:
            return None
        self._reported = problem
        return f"MQTT: {self._broker}: {problem.text}"

    def wait_s(self, luck: float) -> float:
        """Wait before the next try. `luck` (0 … 1) is random: a fleet must not reconnect all at once."""
        first_s, longest_s = FIRST_WAIT_S, MAX_WAIT_S
        if self._problem is not None and self._problem.needs_person:
            first_s, longest_s = FIRST_WAIT_REFUSED_S, MAX_WAIT_REFUSED_S
        doubled_s = first_s * 2.0 ** min(max(0, self._failures - 1), 10)
        return min(doubled_s, longest_s) * (0.5 + 0.5 * luck)

    def _is_stable(self, t: float) -> bool:
        return self._connected_at is not None and t - self._connected_at >= STABLE_S
