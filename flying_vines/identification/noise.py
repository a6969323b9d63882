"""Noise of the sensors: as stated in the rig file, unless the data contradict it."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

import numpy as np

from flying_vines.physics.arrays import Array
from flying_vines.physics.rig import Rig

MIN_KPA = 1e-3
"""Noise of a sensor whose stated noise is 0: recorded values are rounded."""
SURE = 6.0
"""The stated noise is used if the estimate differs from it by a share of less than SURE / √(differences)."""
_GAUSS = 1.4826
"""Standard deviation of a Gaussian over its median absolute deviation."""
_SECOND_DIFFERENCE = 6.0
"""Variance of second differences over that of the independent samples."""
_MIN_DIFFERENCES = 100


def stated_noise_kPa(rig: Rig) -> tuple[float, float]:
    """Standard deviations of control volume's and reservoir's readings, from the rig file."""
    sensors = rig.sensors
    return sensors.cv_noise_std_kPa or MIN_KPA, sensors.reservoir_noise_std_kPa or MIN_KPA


def resolution(readings: Array) -> float:
    """Smallest difference between readings, which are finite; infinite if all are equal."""
    return float(np.min(np.diff(np.unique(readings)), initial=np.inf))


def noise_kPa(residuals: Sequence[Array], stated_kPa: float) -> float:
    """Standard deviation of a sensor's noise, from the residuals of a fit.

    Errors of the model hardly change second differences, and the median ignores the few samples at which a
    valve moves. All samples are used: a regulator only leaves the valves shut while the noise happens to be
    small. If most differences are zero, the resolution is too coarse and the stated noise is returned.

    Args:
        residuals: for each run (n,) kPa, NaN where nothing was read.
    """
    differences = np.concatenate([np.diff(r, 2) for r in residuals])
    differences = np.abs(differences[np.isfinite(differences)])
    if len(differences) < _MIN_DIFFERENCES:
        return stated_kPa
    found = _GAUSS * float(np.median(differences)) / sqrt(_SECOND_DIFFERENCE)
    if found == 0.0 or (stated_kPa > 0.0 and abs(found / stated_kPa - 1.0) < SURE / sqrt(len(differences))):
        return stated_kPa
    return float(found)
