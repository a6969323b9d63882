"""Rates of change from noisy readings, without differentiation.

The change of a pressure within a window is the integral of its rate. So the changes of overlapping windows
are averaged, and all terms of a regression are integrated in the same way, with each valve as recorded. This
is the weak form of such regressions (Messenger & Bortz 2021) with a trapezoid as test function. It stays
exact at the moment when a valve turns; a smoothed derivative smears this moment.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from flying_vines.identification.case import Case, RecordedRun
from flying_vines.identification.fit import FitPoint, FitProblem
from flying_vines.identification.simulate import GAP
from flying_vines.physics.arrays import Array
from flying_vines.physics.constants import ALPHA_KPA
from flying_vines.physics.rig import Rig

WINDOW_S = 0.2
FEWEST = 2
"""Minimum number of samples in a window."""


@dataclass(frozen=True, eq=False)
class Series:
    """One run: n samples, and n − 1 steps between them."""

    time_s: Array
    read_kPa: Array
    """(2, n) reservoir and control volume."""
    evp: Array
    dvp: Array
    solenoid: Array
    """The valves, one value for each step."""
    reservoir_kPa: Array
    cv_kPa: Array
    """The pressures in the middle of each step."""
    bridged: NDArray[np.bool_]
    """True for a step in a gap of rows or readings: values there are interpolated linearly."""

    @property
    def window(self) -> int:
        """Length of the window in steps."""
        return max(FEWEST, round(WINDOW_S / float(np.median(np.diff(self.time_s)))))

    def gain(self, values: Array) -> Array:
        """The change of `values` (n,) within a window, divided by the window's length, averaged over
        overlapping windows. Windows with a gap are left out."""
        n = self.window
        gains = (values[n:] - values[:-n]) / (self.time_s[n:] - self.time_s[:-n])
        holes = np.concatenate(([0], np.cumsum(self.bridged)))
        holes = holes[n:] - holes[:-n]
        whole = len(gains) // n * n
        without: NDArray[np.bool_] = holes[:whole].reshape(-1, n).max(axis=1) == 0
        averaged: Array = gains[:whole].reshape(-1, n)[without].mean(axis=1)
        return averaged

    def mean(self, rate: Array) -> Array:
        """As `gain`, for a quantity with a rate in each step."""
        return self.gain(np.concatenate(([0.0], np.cumsum(rate * np.diff(self.time_s)))))

    def jumps(self, size: Array) -> Array:
        """As `gain`, for a quantity that jumps at the beginning of steps."""
        return self.gain(np.concatenate(([0.0], np.cumsum(size))))


def series(problem: FitProblem, point: FitPoint) -> list[Series]:
    """All runs. A pressure without readings is replaced by the baseline's at `point`."""
    found = []
    for run, (cv, reservoir) in zip(problem.case.runs, problem.simulated(point), strict=True):
        read = np.stack((_filled(run, run.reservoir_kPa, reservoir), _filled(run, run.cv_kPa, cv)))
        middle = (read[:, :-1] + read[:, 1:]) / 2.0
        found.append(
            Series(
                time_s=run.time_s,
                read_kPa=read,
                evp=run.evp_opening[:-1],
                dvp=run.dvp_opening[:-1],
                solenoid=run.solenoid[:-1],
                reservoir_kPa=middle[0],
                cv_kPa=middle[1],
                bridged=_bridged(run),
            )
        )
    return found


def _bridged(run: RecordedRun) -> NDArray[np.bool_]:
    bridged = np.zeros(len(run.time_s) - 1, dtype=np.bool_)
    longest_s = GAP * float(np.median(np.diff(run.time_s)))
    for read in (run.reservoir_kPa, run.cv_kPa):
        there = np.flatnonzero(np.isfinite(read))
        for begin, end in pairwise(there):
            if run.time_s[end] - run.time_s[begin] > longest_s:
                bridged[begin:end] = True
    return bridged


def _filled(run: RecordedRun, read: Array, simulated: Array) -> Array:
    there = np.isfinite(read)
    return np.interp(run.time_s, run.time_s[there], read[there]) if there.any() else simulated


def stacked(every: list[Series], rows: Callable[[Series], Array]) -> tuple[Array, NDArray[np.int_]]:
    """The rows of all runs, one below the other, and for each row the index of its run."""
    found = [rows(one) for one in every]
    whose = np.repeat(np.arange(len(found)), [len(one) for one in found])
    return np.concatenate(found), whose


def inflation(rig: Rig, s: Series) -> Array:
    """Flow through the inflation valve, SL/s."""
    return s.evp * (s.reservoir_kPa - s.cv_kPa) / rig.evp.flow_resistance_kPa_s_per_SL


def motive(rig: Rig, s: Series) -> Array:
    """Flow through the Venturi, SL/s."""
    return s.dvp * s.reservoir_kPa / rig.dvp.flow_resistance_kPa_s_per_SL


def outlet(rig: Rig, s: Series) -> Array:
    """Flow out of the control volume, SL/s."""
    supply = np.minimum(1.0, s.reservoir_kPa / rig.venturi.rated_supply_kPa)
    flow = s.cv_kPa + rig.venturi.full_vacuum_kPa * s.dvp * supply
    flow = np.where(s.dvp > 0.0, np.maximum(flow, 0.0), flow)
    return s.solenoid * flow / rig.solenoid.flow_resistance_kPa_s_per_SL


def per_SL(case: Case) -> tuple[float, float]:
    """The pressure rise of reservoir and control volume by a standard litre, kPa; 0 without a control
    volume."""
    rig = case.rig
    return ALPHA_KPA / rig.reservoir.volume_L, 0.0 if rig.cv is None else ALPHA_KPA / rig.cv.volume_L
