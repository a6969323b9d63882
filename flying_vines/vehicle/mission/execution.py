"""The execution of a mission item."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from flying_vines.vehicle.mission.item import MissionItem


@dataclass(frozen=True, slots=True)
class Execution:
    """A mission item that ran. `seq`, `item` and `params` are None if they are uncertain."""

    command: int
    seq: int | None
    item: MissionItem | None
    params: tuple[float, ...] | None
    age_s: float = 0.0
    """The minimum time since it ran."""
    changed: bool = False
    """The autopilot sent other params than those in the cache."""


def same_numbers(a: Sequence[float], b: Sequence[float]) -> bool:
    """True if the numbers are equal within the precision of 32-bit floats and text files."""
    return all(
        math.isclose(x, y, rel_tol=1e-5, abs_tol=1e-6) or (math.isnan(x) and math.isnan(y))
        for x, y in zip(a, b, strict=True)
    )
