"""The arm state in the autopilot's HEARTBEATs, and if a second sender contradicts it.

Without signing, anybody on the link can send a HEARTBEAT with the autopilot's ids. The autopilot sends its
own once a second, and both arrive. So a forged "armed" lasts at most a second, and the state flips.
"""

from __future__ import annotations

import math

REARMED_S = 3.0
"""No pilot arms a vehicle again so soon after it was disarmed."""
CONFLICT_S = 5.0
"""A conflict ends this long after the last contradiction."""


class ArmState:
    """All times are seconds of one clock."""

    def __init__(self) -> None:
        self.armed = False
        self._armed_at = self._disarmed_at = self._contradicted_at = -math.inf

    def handle(self, t: float, armed: bool) -> None:
        """Take in the arm state of a HEARTBEAT."""
        if armed == self.armed:
            return
        self.armed = armed
        if not armed:
            self._disarmed_at = t
            return
        self._armed_at = t
        if t - self._disarmed_at < REARMED_S:
            self._contradicted_at = t

    def armed_s(self, t: float) -> float:
        """Time since the first of the HEARTBEATs that all said "armed"; 0 if the last one did not."""
        return t - self._armed_at if self.armed else 0.0

    def in_conflict(self, t: float) -> bool:
        """True if two senders disagree about the arm state."""
        return t - self._contradicted_at < CONFLICT_S
