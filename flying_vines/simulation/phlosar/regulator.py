"""The firmware's regulator alone, with any tuning and in double precision.

This is the C++ code of the firmware's core. The core's `regulator.h` describes the regulator and its tuning.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from functools import cache

from flying_vines.physics.baseline import Inputs
from flying_vines.simulation.phlosar.core_library import load

SAFE = Inputs(0.0, 0.0, True)
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
    """The standard tuning. It suits vines of 0.05 to 1 L and supplies of 100 to 690 kPa."""
    return dict(_standard())


class Regulator:
    """One regulator. Call `step` every millisecond with the present pressures.

    `tuning` has the values that differ from the standard; raises `ValueError` for an unknown name. `address`
    is for loops compiled by numba: see `closed_loop`.
    """

    def __init__(self, tuning: Tuning | None = None, *, cv_kPa: float = 0.0) -> None:
        self.tuning = standard_tuning() | dict(tuning or {})
        if unknown := self.tuning.keys() - _standard().keys():
            raise ValueError(f"the regulator has no tuning value {', '.join(sorted(unknown))}")
        self._library = load()
        self._memory = ctypes.create_string_buffer(self._library.phlosar_regulator_size())
        self.address = ctypes.addressof(self._memory)
        self._outputs = (ctypes.c_double * 4)()
        values = (ctypes.c_double * len(self.tuning))(*self.tuning.values())
        self._library.phlosar_regulator_start(self.address, values)
        self.begin(cv_kPa)

    @property
    def setpoint_kPa(self) -> float:
        """The setpoint of the last step, on its way to the target."""
        return self._outputs[3]

    def begin(self, cv_kPa: float) -> None:
        """Start at the measured pressure, so that the setpoint does not jump."""
        self._library.phlosar_regulator_begin(self.address, cv_kPa)

    def step(self, target_kPa: float, rate_kPa_per_s: float, cv_kPa: float, reservoir_kPa: float) -> Inputs:
        """Valve commands for the next millisecond; the setpoint moves to the target at this rate."""
        outputs = self._outputs
        self._library.phlosar_regulator_step(
            self.address, target_kPa, rate_kPa_per_s, cv_kPa, reservoir_kPa, outputs
        )
        return Inputs(outputs[0], outputs[1], outputs[2] > 0.0)
