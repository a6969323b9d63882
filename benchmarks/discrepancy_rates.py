"""Rates of change out of noisy readings, without differentiating them.

What a pressure gains within a window is the integral of its rate; so instead of derivatives the gains of
overlapping windows are averaged, and whatever a rate is to be explained by is integrated in the same way,
valve by valve as recorded. This is the weak form of such regressions (Messenger & Bortz 2021) with a trapeze
as test function: exact where a valve turns, where smooth derivatives smear.
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
"""Samples in a window."""


@dataclass(frozen=True, eq=False)
class Series:
    """One run without holes: n samples, and n − 1 steps from each to the next."""

    time_s: Array
    read_kPa: Array
    """(2, n) reservoir and control volume."""
    evp: Array
    dvp: Array
    solenoid: Array
    """Of each step, as the next two."""
    reservoir_kPa: Array
    cv_kPa: Array
    """In its middle."""
    bridged: NDArray[np.bool_]
    """Whether it lies in a hole, of rows or of readings, over which only a straight line leads."""

    @property
    def window(self) -> int:
        """So many steps."""
        return max(FEWEST, round(WINDOW_S / float(np.median(np.diff(self.time_s)))))

    def gain(self, values: Array) -> Array:
        """What `values` (n,) gain within a window, over its length; averaged over as many that overlap. Those
        with a hole in them are left out."""
        n = self.window
        gains = (values[n:] - values[:-n]) / (self.time_s[n:] - self.time_s[:-n])
        holes = np.concatenate(([0], np.cumsum(self.bridged)))
        holes = holes[n:] - holes[:-n]
        whole = len(gains) // n * n
        without: NDArray[np.bool_] = holes[:whole].reshape(-1, n).max(axis=1) == 0
        averaged: Array = gains[:whole].reshape(-1, n)[without].mean(axis=1)
        return averaged

    def mean(self, rate: Array) -> Array:
        """Of something that has a rate in each step, likewise."""
        return self.gain(np.concatenate(([0.0], np.cumsum(rate * np.diff(self.time_s)))))

    def jumps(self, size: Array) -> Array:
        """Of something that happens at the beginning of steps, likewise."""
        return self.gain(np.concatenate(([0.0], np.cumsum(size))))


def series(problem: FitProblem, point: FitPoint) -> list[Series]:
    """All runs; a pressure that nobody read is what the baseline says at `point`."""
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
    """What each run has, one below the other, and whose it is."""
    found = [rows(one) for one in every]
    whose = np.repeat(np.arange(len(found)), [len(one) for one in found])
    return np.concatenate(found), whose


def inflation(rig: Rig, s: Series) -> Array:
    """Standard litres per second."""
    return s.evp * (s.reservoir_kPa - s.cv_kPa) / rig.evp.flow_resistance_kPa_s_per_SL


def motive(rig: Rig, s: Series) -> Array:
    """Likewise, through the Venturi."""
    return s.dvp * s.reservoir_kPa / rig.dvp.flow_resistance_kPa_s_per_SL


def outlet(rig: Rig, s: Series) -> Array:
    """Likewise, out of the control volume."""
    supply = np.minimum(1.0, s.reservoir_kPa / rig.venturi.rated_supply_kPa)
    flow = s.cv_kPa + rig.venturi.full_vacuum_kPa * s.dvp * supply
    flow = np.where(s.dvp > 0.0, np.maximum(flow, 0.0), flow)
    return s.solenoid * flow / rig.solenoid.flow_resistance_kPa_s_per_SL


def per_SL(case: Case) -> tuple[float, float]:
    """What a standard litre raises reservoir and control volume by, kPa; 0 where there is no CV."""
    rig = case.rig
    return ALPHA_KPA / rig.reservoir.volume_L, 0.0 if rig.cv is None else ALPHA_KPA / rig.cv.volume_L
