"""Free flow and stall pressure of a pump, estimated from the pressure in the chamber that it fills."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import nnls

from flying_vines.physics.arrays import Array
from flying_vines.physics.constants import ALPHA_KPA
from flying_vines.physics.rig import Pump

PUMP_TOLERANCE_PERCENT = 80.0
"""Tolerance of free flow and stall pressure: sensors, hoses and leaks change the rise as well."""
_SPAN_S = 0.3
"""Time over which a rise is measured: longer than a sample, so that noise matters less."""
_MAX_STALL = 3.0
"""Maximum stall pressure, as a multiple of the highest recorded pressure."""


def guessed_pump(runs: Sequence[Mapping[str, Array]], volume_L: float) -> dict[str, float]:
    """The numbers of `[pump]`, from runs with `time`, `cv_pressure` and `evp_opening` (the pump's signal).

    Least squares of dP/dt = a u − b u P while the pump runs, a = α Q_max/V, b = a/P_max. A leak lowers
    both numbers; the tolerance covers this. Without a rise the numbers are those of a small pump.
    """
    rows, rates, top_kPa = [], [], 0.0
    for run in runs:
        use = np.isfinite(run["cv_pressure"])
        t, p, u = run["time"][use], run["cv_pressure"][use], np.nan_to_num(run["evp_opening"])[use]
        shut = np.nan_to_num(run.get("solenoid", np.zeros_like(run["time"])))[use] < 0.5
        top_kPa = max(top_kPa, float(np.sort(p)[-5:].mean()))
        for first in np.searchsorted(t, np.arange(t[0], t[-1] - _SPAN_S, _SPAN_S)):
            last = int(np.searchsorted(t, t[first] + _SPAN_S))
            if last < len(t) and t[last] < t[first] + 3.0 * _SPAN_S and shut[first:last].all():
                mean_u, mean_kPa = float(u[first:last].mean()), float(p[first : last + 1].mean())
                rows.append((mean_u, -mean_u * mean_kPa))
                rates.append(float(p[last] - p[first]) / float(t[last] - t[first]))
    default = Pump()
    numbers = default.free_flow_SL_per_s, max(default.stall_pressure_kPa, top_kPa)
    if rows and top_kPa > 0.0:
        (rise, falls), _ = nnls(np.array(rows), np.array(rates))
        if rise > 0.0:
            stall_kPa = rise / falls if falls > 0.0 else np.inf
            numbers = rise * volume_L / ALPHA_KPA, min(max(stall_kPa, top_kPa), _MAX_STALL * top_kPa)
    flow, stall_kPa = (float(f"{number:.3g}") for number in numbers)
    return {"free_flow_SL_per_s": flow, "stall_pressure_kPa": stall_kPa}
