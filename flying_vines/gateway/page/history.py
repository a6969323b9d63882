"""The pressures of the last two minutes, for a newly opened page."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import msgspec

from flying_vines.gateway.messages import SnapshotMessage

HISTORY_S = 120.0
EVERY_S = 0.19
"""Takes every other snapshot: there are ten a second."""


class Sample(NamedTuple):
    """Time in seconds; gauge kPa, None if unknown. The page gets it as an array."""

    t: float
    cv_kPa: float | None
    command_kPa: float | None
    reservoir_kPa: float | None


class _Pressures(msgspec.Struct, frozen=True):
    t: float
    cv_kPa: float | None
    command_kPa: float | None
    reservoir_kPa: float | None


class History:
    """Call `take` with all snapshots in order."""

    def __init__(self) -> None:
        self.samples: deque[Sample] = deque()

    def take(self, seen: SnapshotMessage) -> None:
        now = _PRESSURES.decode(seen.snapshot)
        if self.samples and now.t - self.samples[-1].t < EVERY_S:
            return
        while self.samples and now.t - self.samples[0].t > HISTORY_S:
            self.samples.popleft()
        pressures = _rounded(now.cv_kPa), _rounded(now.command_kPa), _rounded(now.reservoir_kPa)
        self.samples.append(Sample(round(now.t, 2), *pressures))


def _rounded(pressure_kPa: float | None) -> float | None:
    return None if pressure_kPa is None else round(pressure_kPa, 2)


_PRESSURES = msgspec.json.Decoder(_Pressures)
