"""Another program with our own system and component id.

Ground stations and autopilots cannot tell the two apart, and send commands to either. Component 191 is usual
for companion computers, so this happens. (Our own frames that a router sends back do not count: the codec
drops them.)
"""

from __future__ import annotations

import math
from collections import deque

from flying_vines.vehicle.notice import Notice, Severity

ENOUGH = 2
WITHIN_S = 5.0
AGAIN_S = 60.0


class Clash:
    """Counts messages from our own address, and reports when they repeat."""

    def __init__(self, component_id: int) -> None:
        self._component_id = component_id
        self._heard_at: deque[float] = deque(maxlen=ENOUGH)
        self._told_at = -math.inf

    def heard(self, t: float) -> list[Notice]:
        """A message from our own address that we did not send."""
        self._heard_at.append(t)
        if len(self._heard_at) < ENOUGH or t - self._heard_at[0] > WITHIN_S or t - self._told_at < AGAIN_S:
            return []
        self._told_at = t
        text = f"Vine: component id {self._component_id} is taken by another: set vehicle.component_id"
        return [Notice(t, Severity.ERROR, text)]
