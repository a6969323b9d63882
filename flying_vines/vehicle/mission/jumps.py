"""DO_JUMP: finds the item with which the mission continues."""

from __future__ import annotations

import math

from flying_vines.vehicle.mission.item import MissionItem

JUMP = 177
FOR_EVER = -1


class Jumps:
    """Counts the repetitions of each DO_JUMP."""

    def __init__(self) -> None:
        self._taken: dict[int, int] = {}

    def take(self, item: MissionItem) -> int:
        """The seq of the next item: the jump's target, or the item after it if no repetition is left."""
        target, times = item.params[0], item.params[1]
        taken = self._taken.get(item.seq, 0)
        if not (math.isfinite(target) and target >= 0) or (times != FOR_EVER and not taken < times):
            return item.seq + 1
        self._taken[item.seq] = taken + 1
        return int(target)
