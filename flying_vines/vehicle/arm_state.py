"""Whether a second sender has the autopilot's ids: then two arm states, or two clocks, contradict each other.

Without signing, anybody on the link can send a HEARTBEAT with the autopilot's ids. The autopilot sends its
own once a second, and both arrive. So a forged "armed" lasts at most a second, and the state flips.

Two autopilots with the same system id have booted at different times. So the time stamps go back, forward and
back again. After a reboot they go back once. Two that booted within `BACK_S` cannot be told by their clocks.
"""

from __future__ import annotations

import math

REARMED_S = 3.0
"""No pilot arms a vehicle again so soon after it was disarmed."""
CONFLICT_S = 5.0
"""A conflict ends this long after the last contradiction."""

BACK_S = 3.0
"""Two paths from one autopilot do not differ by so much delay."""
SAME_CLOCK_S = 0.5
"""Stamps of one clock agree within this time. A stamp that stands still differs before `TWO_CLOCKS_S`."""
TWO_CLOCKS_S = 1.0
"""A clock that has returned for this time belongs to a second autopilot."""


class Clocks:
    """Finds two clocks in the time stamps of one sender. All times are seconds of one clock."""

    def __init__(self) -> None:
        self._latest_s = -math.inf
        self._began_at = self._back_at = self._conflict_at = -math.inf
        self._offset_s = math.inf
        """Our time minus the stamp's, when the stamps began to go back to this clock."""

    def stamp(self, t: float, boot_s: float) -> bool:
        """Take in a time stamp that runs. Returns True if it goes back to a clock that was seen before."""
        is_back, self._latest_s = boot_s < self._latest_s - BACK_S, boot_s
        if not is_back:
            return False
        is_known = t - self._back_at < CONFLICT_S and abs(t - boot_s - self._offset_s) < SAME_CLOCK_S
        self._back_at = t
        if not is_known:
            self._began_at, self._offset_s = t, t - boot_s
        elif t - self._began_at >= TWO_CLOCKS_S:
            self._conflict_at = t
        return is_known or self.in_conflict(t)

    def in_conflict(self, t: float) -> bool:
        """True if two autopilots send."""
        return t - self._conflict_at < CONFLICT_S


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
