"""The firmware's regulator alone, with any tuning and in double precision.

It is the core's own C++; see `regulator.h` there for how it regulates and what each value of the tuning is.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from functools import cache
from typing import NamedTuple

from flying_vines.simulation.phlosar.core_library import load


class Drive(NamedTuple):
    """What the valves are told: openings 0…1, solenoid open or not."""

    evp: float
    dvp: float
    solenoid: bool


SAFE = Drive(0.0, 0.0, True)
"""Inflation valve shut, outlet open, Venturi off."""

Tuning = Mapping[str, float]


@cache
def _standard() -> dict[str, float]:
    library = load()
    values = (ctypes.c_double * library.phlosar_tuning_count())()
    library.phlosar_standard_tuning(values)
    names = [library.phlosar_tuning_name(index).decode() for index in range(len(values))]
    return dict(zip(names, values, strict=True))


def standard_tuning() -> dict[str, float]:
    """All tuning values. They suit vines of 0.05 to 1 L and supplies of 100 to 690 kPa."""
    return dict(_standard())


class Regulator:
    """One regulation. Call `step` every millisecond, with the pressures just read.

    `tuning` has what differs from the standard; ValueError for an unknown name. `address` is for loops that
    numba compiles: see `closed_loop`.
    """

    def __init__(self, tuning: Tuning | None = None, *, cv_kPa: float = 0.0) -> None:
        self.tuning = standard_tuning() | dict(tuning or {})
        if unknown := self.tuning.keys() - _standard().keys():
            raise ValueError(f"the regulator has no {', '.join(sorted(unknown))}")
        self._library = load()
        self._memory = ctypes.create_string_buffer(self._library.phlosar_regulator_size())
        self.address = ctypes.addressof(self._memory)
        self._told = (ctypes.c_double * 4)()
        values = (ctypes.c_double * len(self.tuning))(*self.tuning.values())
        self._library.phlosar_regulator_start(self.address, values)
        self.begin(cv_kPa)

    @property
    def setpoint_kPa(self) -> float:
        """What the last step held, on its way to the target."""
        return self._told[3]

    def begin(self, cv_kPa: float) -> None:
        """A regulation begins: the setpoint is the measured pressure, so that nothing jumps."""
        self._library.phlosar_regulator_begin(self.address, cv_kPa)

    def step(self, target_kPa: float, rate_kPa_per_s: float, cv_kPa: float, reservoir_kPa: float) -> Drive:
        """The valves for the next millisecond. The setpoint goes towards the target, at most at this rate."""
        told = self._told
        self._library.phlosar_regulator_step(
            self.address, target_kPa, rate_kPa_per_s, cv_kPa, reservoir_kPa, told
        )
        return Drive(told[0], told[1], told[2] > 0.0)
