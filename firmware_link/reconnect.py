"""When a connection is closed and opened again: one policy for serial ports, sockets, pages and brokers.

`Reconnect` is a pure state machine over the time that is passed in. `KeptOpen` runs it on asyncio's clock.
"""

from __future__ import annotations

import asyncio
import math
import os
import random
import socket
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from enum import Enum
from typing import Any, NamedTuple

STABLE_S = 3.0
"""A connection that has lasted this long works."""
SHORT_LIVED = 3
"""After this number of shorter connections in a row, the next one is reported as up only once it works."""
LONGEST_QUIET_S = 30.0
"""A silent peer may be switched off. Each silence in a row is allowed to last twice as long, up to this."""
CHECK_S = 0.2
LEAVING_S = 3.0
"""Time for a connection to end after it was cancelled."""


class Problem(NamedTuple):
    """Why there is no connection, and True if a person must act."""

    text: str
    needs_person: bool = False


@dataclass(frozen=True, slots=True)
class Policy:
    """The times of one medium, in seconds."""

    first_wait_s: float
    """Wait before the second try. Each further wait is twice as long."""
    longest_wait_s: float
    refused_waits_s: tuple[float, float] | None = None
    """The first and the longest wait while a person must change something; None: the usual ones."""
    spread: float = 0.0
    """The random share of a wait: many vehicles must not reconnect at the same moment."""
    opens_within_s: float = math.inf
    """A try that takes longer is given up."""
    quiet_s: float = math.inf
    """A connection without a byte for this time is closed and opened again."""
    report_after_s: float = 0.0
    """Shorter interruptions are not reported."""
    short_lived: Problem | None = None
    """The problem if connections never last; None: the problem of the last one."""


class LinkState(Enum):
    CLOSED = "closed"
    OPENING = "opening"
    OPEN = "open"
    QUIET = "quiet"
    """The connection was silent. It is opened again at once, and reported only if that fails."""


class Change(NamedTuple):
    """The connection is up or down, and what to say about it."""

    up: bool
    why: str


class Reconnect:
    """The state of one connection, which is first tried at time `t`. All times are seconds of one clock.

    Call `opening`, `opened` and `ended` when these happen, and `lasts` and `overdue` regularly. A change is
    returned once, when it is to be reported.
    """

    def __init__(self, policy: Policy, t: float) -> None:
        self.state = LinkState.CLOSED
        self._policy = policy
        self._since = self._heard_at = t
        self._worked_at = t
        self._up_text = ""
        self._problem = Problem("")
        self._reported: Change | None = None
        self._failures = self._short_lived = self._silences = 0

    @property
    def is_open(self) -> bool:
        return self.state is LinkState.OPEN

    @property
    def is_silent(self) -> bool:
        """True after a silence, until bytes arrive again."""
        return self._silences > 0

    def opening(self, t: float) -> None:
        """A try begins."""
        self.state, self._since = LinkState.OPENING, t

    def opened(self, t: float, text: str = "") -> Change | None:
        self.state, self._since, self._heard_at, self._up_text = LinkState.OPEN, t, t, text
        return self.lasts(t)

    def heard(self, t: float) -> None:
        """Bytes arrived."""
        self._heard_at, self._silences = t, 0

    def lasts(self, t: float) -> Change | None:
        """The connection may still exist."""
        reports_late = self._policy.report_after_s > 0.0
        doubtful = reports_late or self._short_lived >= SHORT_LIVED
        if not self.is_open or (doubtful and t - self._since < STABLE_S):
            return None
        is_known = reports_late if self._reported is None else self._reported.up
        return None if is_known else self._report(Change(True, self._up_text))

    def overdue(self, t: float) -> bool:
        """True if the try takes too long, or the connection is silent: end it."""
        if self.state is LinkState.OPENING:
            return t - self._since >= self._policy.opens_within_s
        longest_s = max(self._policy.quiet_s, LONGEST_QUIET_S)
        quiet_s = min(self._policy.quiet_s * 2.0 ** min(self._silences, 10), longest_s)
        return self.is_open and t - self._heard_at >= quiet_s

    def ended(self, t: float, problem: Problem | None) -> Change | None:
        """A try failed, or a connection ended. None: we ended it, because it was overdue."""
        if was_open := self.is_open:
            self._silences = self._silences + 1 if problem is None else 0
            if t - self._since >= STABLE_S:
                self._failures = self._short_lived = 0
                self._worked_at = t
            else:
                self._short_lived += 1
            if problem is None:
                self.state = LinkState.QUIET
                return None
        elif problem is None:
            problem = Problem("no answer")
        if was_open and self._short_lived >= SHORT_LIVED and not problem.needs_person:
            problem = self._policy.short_lived or problem
        self.state, self._problem = LinkState.CLOSED, problem
        self._failures += 1
        lasting = problem.needs_person or t - self._worked_at >= self._policy.report_after_s
        change = Change(False, problem.text)
        return self._report(change) if lasting and change != self._reported else None

    def wait_s(self, luck: float) -> float:
        """Wait before the next try. `luck` (0 … 1) is random."""
        if self.state is LinkState.QUIET:
            return 0.0
        waits_s = (self._policy.first_wait_s, self._policy.longest_wait_s)
        if self._problem.needs_person and self._policy.refused_waits_s:
            waits_s = self._policy.refused_waits_s
        doubled_s = waits_s[0] * 2.0 ** min(max(0, self._failures - 1), 10)
        return min(doubled_s, waits_s[1]) * (1.0 - self._policy.spread * (1.0 - luck))

    def _report(self, change: Change) -> Change:
        self._reported = change
        return change


class KeptOpen:
    """Keeps a connection open.

    `connect` opens the connection, calls `opened`, and returns why it failed or ended. It is cancelled when
    the policy ends the connection. `on_state(up, why)` gets the changes.
    """

    def __init__(
        self,
        policy: Policy,
        connect: Callable[[], Coroutine[Any, Any, Problem]],
        on_state: Callable[[bool, str], None],
    ) -> None:
        self._policy = policy
        self._connect = connect
        self._on_state = on_state
        self._link = Reconnect(policy, 0.0)

    @property
    def is_open(self) -> bool:
        return self._link.is_open

    @property
    def is_silent(self) -> bool:
        return self._link.is_silent

    def opened(self, text: str = "") -> None:
        self._tell(self._link.opened(_now(), text))

    def heard(self) -> None:
        """Bytes arrived."""
        self._link.heard(_now())

    async def run(self) -> None:
        """Run until cancelled. An unexpected exception of `connect` is raised."""
        self._link = link = Reconnect(self._policy, _now())
        while True:
            link.opening(_now())
            connection = asyncio.create_task(self._connect())
            overdue = False
            try:
                while not (overdue or connection.done()):
                    await asyncio.wait({connection}, timeout=CHECK_S)
                    if not connection.done():
                        self._tell(link.lasts(_now()))
                        overdue = link.overdue(_now())
            finally:
                # Cancel repeatedly: a library may lose a cancellation that arrives with an awaited result.
                while not connection.done():
                    connection.cancel()
                    await asyncio.wait({connection}, timeout=LEAVING_S)
            problem = Problem("it was closed") if connection.cancelled() else connection.result()
            self._tell(link.ended(_now(), None if overdue else problem))
            await asyncio.sleep(link.wait_s(random.random()))

    def _tell(self, change: Change | None) -> None:
        if change is not None:
            self._on_state(*change)


def why_not(error: OSError | UnicodeError) -> str:
    """The operating system's text for the error. An invalid host name raises a `UnicodeError`."""
    if isinstance(error, TimeoutError):
        return "no answer"
    if isinstance(error, OSError) and error.errno and not isinstance(error, socket.gaierror):
        return os.strerror(error.errno)
    return getattr(error, "strerror", None) or str(error)


def _now() -> float:
    return asyncio.get_running_loop().time()
