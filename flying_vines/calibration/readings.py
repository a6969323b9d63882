"""The telemetry of a stretch as arrays."""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from firmware_link.protocol import Mode, Telemetry
from flying_vines.physics.arrays import Array, BoolArray

OUTLET_LAG_S = 0.06
"""After it is told to shut an outlet may still let air out."""
_CLOCK_MS = 1 << 32


@dataclass(frozen=True)
class Readings:
    """A row for each telemetry message; kPa gauge, openings 0…1 as the valves were told."""

    t_s: Array
    """Of the board's clock, from where it was first heard."""
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
        """From one row to the next."""
        return float(np.median(np.diff(self.t_s)))

    @cached_property
    def shut(self) -> BoolArray:
        """Whether the outlet has been told shut for so long that it is."""
        told_open = self.t_s[self.solenoid]
        last = np.searchsorted(told_open, self.t_s, "right") - 1
        since_s = np.where(last >= 0, self.t_s - told_open[np.maximum(last, 0)], np.inf)
        return since_s > OUTLET_LAG_S if len(told_open) else np.ones(len(self), bool)

    def rows(self, where: slice | BoolArray) -> Readings:
        """Some of them."""
        return Readings(*(getattr(self, name)[where] for name in _COLUMNS))

    def less_zero(self, cv_zero_kPa: float) -> Readings:
        """With the vine's pressures as they are once its sensor's zero is taken out."""
        return replace(self, cv_kPa=self.cv_kPa - cv_zero_kPa)

    def stretches(self, so: BoolArray) -> Iterator[slice]:
        """Each run of rows for which it is so, in order."""
        edges = np.flatnonzero(np.diff(np.concatenate([[0], so.astype(np.int8), [0]])))
        for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
            yield slice(begin, end)


_COLUMNS = tuple(Readings.__dataclass_fields__)


class Notebook:
    """Writes telemetry down, message by message."""

    def __init__(self) -> None:
        self._columns = [array("d") for _ in _COLUMNS]
        self._first_ms: int | None = None

    def __len__(self) -> int:
        return len(self._columns[0])

    def take(self, telemetry: Telemetry) -> None:
        """The next message. Its clock may wrap."""
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
        """What was written from a row on."""
        t, regulating, setpoint, cv, reservoir, evp, dvp, solenoid = (
            np.array(column[first:], np.float64) for column in self._columns
        )
        return Readings(t, regulating > 0.5, setpoint, cv, reservoir, evp, dvp, solenoid > 0.5)
