"""The telemetry of a calibration as arrays."""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from math import sqrt

import numpy as np

from firmware_link.protocol import Mode, Telemetry
from flying_vines.physics.arrays import Array, BoolArray

OUTLET_LAG_S = 0.06
"""Maximum time that an outlet needs to close."""
_CLOCK_MS = 1 << 32


@dataclass(frozen=True)
class Readings:
    """One row for each telemetry message. Pressures are gauge; openings are commands, 0…1."""

    t_s: Array
    """Time of the board's clock since the first message."""
    regulating: BoolArray
    setpoint_kPa: Array
    cv_kPa: Array
    reservoir_kPa: Array
    evp: Array
    dvp: Array
    solenoid: BoolArray

    def __len__(self) -> int:
        return len(self.t_s)

    @cached_property
    def step_s(self) -> float:
        """Usual time between rows."""
        return float(np.median(np.diff(self.t_s)))

    @cached_property
    def shut(self) -> BoolArray:
        """True where the outlet has been commanded shut for long enough to be shut."""
        opened_s = self.t_s[self.solenoid]
        last = np.searchsorted(opened_s, self.t_s, "right") - 1
        since_s = np.where(last >= 0, self.t_s - opened_s[np.maximum(last, 0)], np.inf)
        return since_s > OUTLET_LAG_S if len(opened_s) else np.ones(len(self), bool)

    def less_zero(self, cv_zero_kPa: float, reservoir_zero_kPa: float) -> Readings:
        """The readings with the zeros of both sensors subtracted."""
        return replace(
            self, cv_kPa=self.cv_kPa - cv_zero_kPa, reservoir_kPa=self.reservoir_kPa - reservoir_zero_kPa
        )

    def stretches(self, where: BoolArray) -> Iterator[slice]:
        """Each run of consecutive rows that are True, in order."""
        edges = np.flatnonzero(np.diff(np.concatenate([[0], where.astype(np.int8), [0]])))
        for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
            yield slice(begin, end)


_COLUMNS = tuple(Readings.__dataclass_fields__)


class ReadingsBuffer:
    """Collects telemetry messages."""

    def __init__(self) -> None:
        self._columns = [array("d") for _ in _COLUMNS]
        self._first_ms: int | None = None

    def __len__(self) -> int:
        return len(self._columns[0])

    def append(self, telemetry: Telemetry) -> None:
        """Add a message. The board's clock may wrap."""
        if self._first_ms is None:
            self._first_ms = telemetry.device_time_ms
        values = (
            (telemetry.device_time_ms - self._first_ms) % _CLOCK_MS / 1000.0,
            telemetry.mode is Mode.REGULATE,
            telemetry.setpoint_kPa,
            telemetry.cv_kPa,
            telemetry.reservoir_kPa,
            telemetry.evp_opening,
            telemetry.dvp_opening,
            telemetry.solenoid,
        )
        for column, value in zip(self._columns, values, strict=True):
            column.append(value)

    def readings(self, first: int = 0) -> Readings:
        """All rows from `first` on."""
        t, regulating, setpoint, cv, reservoir, evp, dvp, solenoid = (
            np.array(column[first:], np.float64) for column in self._columns
        )
        return Readings(t, regulating > 0.5, setpoint, cv, reservoir, evp, dvp, solenoid > 0.5)


def noise_kPa(column: Array) -> float:
    """Standard deviation of the noise, from differences of successive readings. Slow changes do not count."""
    return float(np.std(np.diff(column))) / sqrt(2.0)


def smooth(column: Array, rows: int) -> Array:
    """Centred means over this many rows, fewer at the ends."""
    sums = np.concatenate([[0.0], np.cumsum(column)])
    at = np.arange(len(column))
    begin, end = np.maximum(at - rows // 2, 0), np.minimum(at + rows // 2 + 1, len(column))
    return np.asarray((sums[end] - sums[begin]) / (end - begin))
