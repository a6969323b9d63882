"""How a connection fares: what people are told of it, and how long to wait before the next try. No clock."""

from __future__ import annotations

from typing import NamedTuple

FIRST_WAIT_S, LONGEST_WAIT_S = 1.0, 60.0
FIRST_WAIT_REFUSED_S, LONGEST_WAIT_REFUSED_S = 15.0, 300.0
"""Somebody must change something before it is of use to try again."""
TOLD_AFTER_S = 5.0
"""A shorter interruption is nobody's trouble: nothing is lost by it."""
WELL_S = 3.0
"""A connection that has lasted for so long is one."""


SHORT_LIVED = 3
"""So many connections in a row that did not last are no accident."""


class BrokerProblem(NamedTuple):
    """Why there is no connection: a sentence; and whether a person has to do something about it."""

    text: str
    needs_person: bool = False


THROWN_OUT = BrokerProblem(
    "lets us in and closes: has another vehicle the same mqtt.name?", needs_person=True
)
"""Not every broker says that somebody else came with our client id."""


class Health:
    """Of the connection to one broker, which is looked for from `t` on."""

    def __init__(self, t: float, broker: str) -> None:
        self._broker = broker
        self._connected_at: float | None = None
        self._lost_at = t
        self._problem: BrokerProblem | None = None
        self._told: BrokerProblem | None = None
        self._failures = 0
        self._short_lived = 0

    @property
    def is_connected(self) -> bool:
        """Until it `failed`."""
        return self._connected_at is not None

    def connected(self, t: float) -> None:
        self._connected_at = t

    def lasts(self, t: float) -> str | None:
        """It is still there; what people are to be told, if anything."""
        if self._told is None or not self._is_well(t):
            return None
        self._told = None
        return f"MQTT: {self._broker} is back"

    def failed(self, t: float, problem: BrokerProblem) -> str | None:
        """A try that failed, or a connection that ended; what people are to be told, if anything."""
        if self._is_well(t):
            self._failures = self._short_lived = 0
            self._lost_at = t
        elif self.is_connected:
            self._short_lived += 1
            if self._short_lived >= SHORT_LIVED and not problem.needs_person:
                problem = THROWN_OUT
        self._connected_at = None
        self._failures += 1
        self._problem = problem
        lasting = problem.needs_person or t - self._lost_at >= TOLD_AFTER_S
        if not lasting or problem == self._told:
            return None
        self._told = problem
        return f"MQTT: {self._broker}: {problem.text}"

    def wait_s(self, luck: float) -> float:
        """Before the next try. `luck` of 0 … 1: not the whole fleet is to come back in the same second."""
        first_s, longest_s = FIRST_WAIT_S, LONGEST_WAIT_S
        if self._problem is not None and self._problem.needs_person:
            first_s, longest_s = FIRST_WAIT_REFUSED_S, LONGEST_WAIT_REFUSED_S
        doubled_s = first_s * 2.0 ** min(max(0, self._failures - 1), 10)
        return min(doubled_s, longest_s) * (0.5 + 0.5 * luck)

    def _is_well(self, t: float) -> bool:
        return self._connected_at is not None and t - self._connected_at >= WELL_S
