"""Numbers of what fills a chamber, a pump or a valve, estimated from the rises of the chamber's pressure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

from flying_vines.physics.arrays import Array
from flying_vines.physics.constants import ALPHA_KPA
from flying_vines.physics.rig import Pump

_SPAN_S = 0.3
"""Time over which a rise is measured: longer than a sample, so that noise matters less."""
_MAX_STALL = 3.0
"""Maximum stall pressure, as a multiple of the highest recorded pressure."""


class _Rise(NamedTuple):
    """Means over a time in which the outlet is shut, and the rise of the chamber's pressure."""

    opening: float
    cv_kPa: float
    reservoir_kPa: float
    """NaN if it was not recorded."""
    rate_kPa_per_s: float


def guessed_pump(runs: Sequence[Mapping[str, Array]], volume_L: float) -> dict[str, float]:
    """The numbers of `[pump]`, from runs with `time`, `cv_pressure` and `evp_opening` (the pump's signal).

    Least squares of dP/dt = a u − b u P while the pump runs, a = α Q_max/V, b = a/P_max. A leak lowers both;
    the tolerance covers this. Without a rise the numbers are those of a small pump.
    """
    rises = list(_rises(runs))
    top_kPa = max(float(np.sort(p[np.isfinite(p)])[-5:].mean()) for p in (run["cv_pressure"] for run in runs))
    default = Pump()
    numbers = default.free_flow_SL_per_s, max(default.stall_pressure_kPa, top_kPa)
    if rises and top_kPa > 0.0:
        rows = [(rise.opening, -rise.opening * rise.cv_kPa) for rise in rises]
        (a, b), _ = nnls(np.array(rows), np.array([rise.rate_kPa_per_s for rise in rises]))
        if a > 0.0:
            stall_kPa = a / b if b > 0.0 else np.inf
            numbers = a * volume_L / ALPHA_KPA, min(max(stall_kPa, top_kPa), _MAX_STALL * top_kPa)
    flow, stall_kPa = (float(f"{number:.3g}") for number in numbers)
    return {"free_flow_SL_per_s": flow, "stall_pressure_kPa": stall_kPa}


def guessed_valve(runs: Sequence[Mapping[str, Array]], volume_L: float) -> dict[str, float]:
    """The flow resistance of the inflation valve, from runs that also have `reservoir_pressure`.

    It is empty if the pressure never rises.

    Least squares of dP_cv/dt = α u (P_r − P_cv) / (R V).
    """
    rises = [rise for rise in _rises(runs) if np.isfinite(rise.reservoir_kPa)]
    drives = np.array([rise.opening * (rise.reservoir_kPa - rise.cv_kPa) for rise in rises])
    rates = np.array([rise.rate_kPa_per_s for rise in rises])
    if not drives.any() or not drives @ rates > 0.0:
        return {}
    R = ALPHA_KPA / volume_L * float(drives @ drives) / float(drives @ rates)
    return {"flow_resistance_kPa_s_per_SL": float(f"{R:.4g}")}


def _rises(runs: Sequence[Mapping[str, Array]]) -> Iterator[_Rise]:
    for run in runs:
        use = np.isfinite(run["cv_pressure"])
        t, p, u = run["time"][use], run["cv_pressure"][use], np.nan_to_num(run["evp_opening"])[use]
        shut = np.nan_to_num(run.get("solenoid", np.zeros_like(run["time"])))[use] < 0.5
        reservoir = run.get("reservoir_pressure", np.full_like(run["time"], np.nan))[use]
        for first in np.searchsorted(t, np.arange(t[0], t[-1] - _SPAN_S, _SPAN_S)):
            last = int(np.searchsorted(t, t[first] + _SPAN_S))
            if last < len(t) and t[last] < t[first] + 3.0 * _SPAN_S and shut[first:last].all():
                yield _Rise(
                    float(u[first:last].mean()),
                    float(p[first : last + 1].mean()),
                    float(reservoir[first : last + 1].mean()),
                    float(p[last] - p[first]) / float(t[last] - t[first]),
                )
