"""Detects another program with our system and component id.

Ground stations and autopilots cannot distinguish the two programs, and send commands to both. Two programs
easily have the same id, because 191 is the usual component id of companion computers. (If a router sends our
own frames back, the codec drops them.)
"""

from __future__ import annotations

import math
from collections import deque

from flying_vines.vehicle.notice import Notice, Severity

MIN_MESSAGES = 2
WITHIN_S = 5.0
REPORT_AGAIN_S = 60.0


class DuplicateIdDetector:
    """Counts messages from our own address, and reports when they repeat."""

    def __init__(self, component_id: int) -> None:
        self._component_id = component_id
        self._received_at: deque[float] = deque(maxlen=MIN_MESSAGES)
        self._reported_at = -math.inf

    def received(self, t: float) -> list[Notice]:
        """A message from our own address that we did not send."""
        self._received_at.append(t)
        if len(self._received_at) < MIN_MESSAGES or t - self._received_at[0] > WITHIN_S:
            return []
        if t - self._reported_at < REPORT_AGAIN_S:
            return []
        self._reported_at = t
        text = f"Vine: another program has component id {self._component_id}: set vehicle.component_id"
        return [Notice(t, Severity.ERROR, text)]
