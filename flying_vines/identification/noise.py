"""How noisy the sensors are: what the rig states, unless the data say otherwise."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

import numpy as np

from flying_vines.physics.arrays import Array
from flying_vines.physics.rig import Rig

LEAST_KPA = 1e-3
"""Noise of a sensor that is stated to have none: what is written is rounded."""
SURE = 6.0
"""Over the square root of how many differences there are: nearer than this share what is stated is kept."""
_GAUSS = 1.4826
"""Standard deviation of a Gaussian over its median absolute deviation."""
_SECOND_DIFFERENCE = 6.0
"""Its variance over that of independent samples."""
_FEWEST = 100


def stated_noise_kPa(rig: Rig) -> tuple[float, float]:
    """Standard deviations of control volume's and reservoir's readings, as the rig states them."""
    sensors = rig.sensors
    return sensors.cv_noise_std_kPa or LEAST_KPA, sensors.reservoir_noise_std_kPa or LEAST_KPA


def resolution(readings: Array) -> float:
    """Smallest difference between readings, which are finite; infinite if all are equal."""
    return float(np.min(np.diff(np.unique(readings)), initial=np.inf))


def noise_kPa(residuals: Sequence[Array], stated_kPa: float) -> float:
    """Standard deviation of a sensor's noise, from what is left of its readings after a fit.

    What a simulation lacks hardly shows in second differences, and the median does not see the few samples
    at which a valve turns. All samples count: a regulator that acts on what it reads leaves quiet stretches
    only while the noise happens to be small. Readings so coarse that most differences vanish say nothing.

    Args:
        residuals: a run's each, (n,) kPa, NaN where nothing was read.
    """
    differences = np.concatenate([np.diff(r, 2) for r in residuals])
    differences = np.abs(differences[np.isfinite(differences)])
    if len(differences) < _FEWEST:
        return stated_kPa
    found = _GAUSS * float(np.median(differences)) / sqrt(_SECOND_DIFFERENCE)
    if found == 0.0 or (stated_kPa > 0.0 and abs(found / stated_kPa - 1.0) < SURE / sqrt(len(differences))):
        return stated_kPa
    return float(found)
