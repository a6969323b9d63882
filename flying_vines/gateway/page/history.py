"""The last two minutes of pressures, for whoever opens the page now."""

from __future__ import annotations

from collections import deque

import msgspec

from flying_vines.gateway.messages import Seen

KEPT_S = 120.0
EVERY_S = 0.19
"""Every second one of ten a second."""


class Sample(msgspec.Struct, frozen=True, array_like=True):
    """Of a snapshot: gauge kPa, None where it is not known."""

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
    """Takes all snapshots, in order."""

    def __init__(self) -> None:
        self.samples: deque[Sample] = deque()

    def take(self, seen: Seen) -> None:
        now = _PRESSURES.decode(seen.snapshot)
        if self.samples and now.t - self.samples[-1].t < EVERY_S:
            return
        while self.samples and now.t - self.samples[0].t > KEPT_S:
            self.samples.popleft()
        self.samples.append(
            Sample(
                round(now.t, 2),
                _rounded(now.cv_kPa),
                _rounded(now.command_kPa),
                _rounded(now.reservoir_kPa),
            )
        )


def _rounded(pressure_kPa: float | None) -> float | None:
    return None if pressure_kPa is None else round(pressure_kPa, 2)


_PRESSURES = msgspec.json.Decoder(_Pressures)
