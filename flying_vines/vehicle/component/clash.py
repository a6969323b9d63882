"""Somebody else speaks as we do: the same system, the same component.

Ground stations and autopilots would take the two for one and send commands to either. Component 191 is the
usual one of companion computers, so it happens. (Our own frames, should a router send them back, never get
here: the codec drops them.)
"""

from __future__ import annotations

import math
from collections import deque

from flying_vines.vehicle.notice import Notice, Severity

ENOUGH = 2
WITHIN_S = 5.0
AGAIN_S = 60.0


class Clash:
    """Told of each message that bears our own address; says when that is no accident."""

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
