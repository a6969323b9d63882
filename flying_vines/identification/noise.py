"""Noise of the sensors: as stated in the rig file, unless the data contradict it.

The noise is independent from reading to reading, or has the correlation exp(−t/T) of a filter in the sensor.
A converter rounds the readings to steps. Rounding errors are noise if the pressure changes by more than one
step from reading to reading. Otherwise they stay the same for many readings.

A motor or a valve can cause spikes: single readings far from their neighbours. They are no noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from flying_vines.physics.arrays import Array, BoolArray
from flying_vines.physics.rig import Rig

MIN_KPA = 1e-3
"""Noise of a sensor whose stated noise is 0: recorded values are rounded."""
SURE = 6.0
"""The stated noise is used if the estimate differs by less than the share SURE / √(number of differences)."""
_KEPT = 0.8
"""Only this share of the differences is used, the smallest ones: the largest occur when a valve moves."""
_KEPT_VARIANCE = 0.4377
"""Variance of the smallest 80 % (by size) of a Gaussian, over that of all."""
_MIN_DIFFERENCES = 100
_NEIGHBOURS = 17
_ITERATIONS = 30
_JUMP = 4.0
"""A difference is a jump if it is more than this many median absolute deviations away from the median."""
_MAX_CORRELATION = 0.97
MAX_OVER_RESIDUALS = 1.2
"""Maximum standard deviation of noise over the rms of the residuals, which include the model's errors."""
_STEP_QUANTILE = 0.1
_MANY_EQUAL = 0.5
"""Readings are rounded if the number of different values is below this share of the number of readings."""


class SensorNoise(NamedTuple):
    """Noise of one sensor."""

    std_kPa: float
    correlation: float = 0.0
    """Between successive readings, 0…1."""
    step_kPa: float = 0.0
    """The readings are rounded to multiples of this; 0 if they are not."""

    @property
    def slow_std_kPa(self) -> float:
        """Standard deviation of independent noise that gives the same error of a mean of many readings."""
        return self.std_kPa / sqrt(self.variance_over_slow)

    @property
    def variance_over_slow(self) -> float:
        """Variance of the readings over the square of `slow_std_kPa`; 1 without correlation."""
        return (1.0 - self.correlation) / (1.0 + self.correlation)


Noise = tuple[SensorNoise, SensorNoise]
"""The noise of the sensors of control volume and reservoir."""


def rounded_noise(std_kPa: float, step_kPa: float) -> SensorNoise:
    """Noise of this standard deviation, or of the rounding if that is larger."""
    return SensorNoise(max(std_kPa, step_kPa / sqrt(12.0)), 0.0, step_kPa)


def stated_noise(rig: Rig, readings: Sequence[Array] = ()) -> Noise:
    """The noise in the rig file, and at least that of rounding.

    Args:
        readings: for each run (2, n) kPa, control volume and reservoir; NaN where nothing was read.
    """
    sensors = rig.sensors
    stated = (sensors.cv_noise_std_kPa or MIN_KPA, sensors.reservoir_noise_std_kPa or MIN_KPA)
    steps = [
        rounding_step(np.concatenate([run[row] for run in readings])) if readings else 0.0 for row in (0, 1)
    ]
    cv, reservoir = (rounded_noise(std, step) for std, step in zip(stated, steps, strict=True))
    return cv, reservoir


def resolution(readings: Array) -> float:
    """Smallest difference between unequal readings; infinite if all are equal. They must be finite."""
    return float(np.min(np.diff(np.unique(readings)), initial=np.inf))


def rounding_step(readings: Array) -> float:
    """The step to which readings were rounded; 0 if too few are equal to tell. NaN is ignored.

    It is the 10 % quantile of the differences between neighbouring levels. Many differences are several
    steps, because no reading is at the levels between, for example where the pressure falls fast. The
    smallest difference may be less than a step: readings in other units may have been rounded twice.
    """
    read = readings[np.isfinite(readings)]
    levels = np.unique(read)
    if not 1 < len(levels) < _MANY_EQUAL * len(read):
        return 0.0
    return float(np.quantile(np.diff(levels), _STEP_QUANTILE))


def measured_noise(
    residuals: Sequence[Array], stated: SensorNoise, *, may_correlate: bool = True
) -> SensorNoise:
    """The noise of a sensor, from the residuals of a fit.

    Errors of the model hardly change the differences of successive readings, and the few readings at which a
    valve moves are left out. All other samples are used, and not only those with shut valves: a regulator
    only leaves the valves shut while the noise happens to be small. If 80 % of the second differences are
    zero, the steps of rounding are too coarse, and the stated noise is returned.

    Args:
        residuals: for each run (n,) kPa, NaN where nothing was read.
        may_correlate: False if the model may have large errors, which look like correlated noise.
    """
    second, count = _mean_square([np.diff(r, 2) for r in residuals])
    if count < _MIN_DIFFERENCES or second == 0.0:
        return stated
    sure, correlation = SURE / sqrt(count), 0.0
    std = sqrt(second / 6.0)
    if may_correlate:
        first, count = _mean_square([_about_mean(np.diff(r)) for r in residuals])
        # Var Δ = 2 (1 − ρ) σ², Var Δ² = (6 − 8 ρ + 2 ρ²) σ²: their ratio is 3 − ρ.
        if count > _MIN_DIFFERENCES and 3.0 - second / first > 3.0 * SURE / sqrt(count):
            for _ in range(_ITERATIONS):
                whole = first / _left_about_mean(correlation)
                correlation = min(3.0 - second / whole, _MAX_CORRELATION)
            std = sqrt(whole / (2.0 * (1.0 - correlation)))
            # A vibration looks like correlated noise, but the residuals are smaller than such noise would be.
            largest = MAX_OVER_RESIDUALS * _rms(residuals)
            if std > largest:
                std, correlation = largest, max(0.0, 1.0 - whole / (2.0 * largest**2))
    found = rounded_noise(std, stated.step_kPa)._replace(correlation=correlation)
    if correlation == 0.0 and abs(found.std_kPa - stated.std_kPa) < sure * stated.std_kPa:
        return stated
    return found


def _about_mean(differences: Array) -> Array:
    """Differences minus the mean of their neighbours: a slope of the residuals is an error of the model."""
    if len(differences) < _NEIGHBOURS:
        return differences[:0]
    # A jump of the residuals must not count in all of its neighbours.
    middle = np.nanmedian(differences)
    reach = _JUMP * np.nanmedian(np.abs(differences - middle))
    usual = np.clip(differences, middle - reach, middle + reach)
    mean = np.convolve(usual, np.full(_NEIGHBOURS, 1.0 / _NEIGHBOURS), mode="valid")
    half = _NEIGHBOURS // 2
    about: Array = differences[half:-half] - mean
    return about


def _left_about_mean(correlation: float) -> float:
    """Share of the differences' variance that `_about_mean` leaves."""
    n, rho = _NEIGHBOURS, correlation
    return 1.0 - 2.0 * rho ** (n // 2) / n + (1.0 - rho**n) / (1.0 - rho) / n**2


def _rms(residuals: Sequence[Array]) -> float:
    every = np.concatenate(residuals)
    return float(np.sqrt(np.nanmean(every**2)))


def _mean_square(differences: Sequence[Array]) -> tuple[float, int]:
    """Mean square of Gaussian differences, estimated from the smaller ones; and the number of differences."""
    size = np.concatenate(differences)
    size = np.sort(np.abs(size[np.isfinite(size)]))
    kept = size[: round(_KEPT * len(size))]
    return float(np.mean(kept**2)) / _KEPT_VARIANCE if len(kept) else 0.0, len(size)


_WIDTH = 5
"""Width of the running median in readings: it finds up to two spikes in succession, and keeps steps."""
_MIN_SPAN = 0.1
"""Minimum distance of a spike from its neighbours, over the span of the other readings."""
_MIN_NOISE = 12.0
"""Minimum distance in standard deviations of the noise."""
_SMOOTH = 0.98
"""Share of the steps between the other readings that must be smaller than half the smallest spike."""
_MAX_SHARE = 0.1
"""If a larger share of the readings looks like spikes, none of them counts as a spike."""


def without_spikes(readings: Array) -> Array:
    """The readings without spikes and missing ones."""
    kept: Array = readings[np.isfinite(readings) & ~is_spike(readings)]
    return kept


def is_spike(readings: Array) -> BoolArray:
    """True for each spike; all False if too many look like spikes. Missing readings are no spikes."""
    found = np.zeros(len(readings), dtype=bool)
    there = np.flatnonzero(np.isfinite(readings))
    few, nearest = _MAX_SHARE * len(there), np.inf
    while len(there) >= 4 * _WIDTH:
        x = readings[there]
        middle = median_filter(x, _WIDTH, mode="nearest")
        distance = np.abs(x - middle)
        noise = 1.48 * float(np.median(distance[distance > 0.0])) if (distance > 0.0).any() else 0.0
        far = distance > max(_MIN_SPAN * float(np.ptp(middle)), _MIN_NOISE * noise)
        if not far.any():
            # If the pressure itself moves as far between readings, a single far reading may be real.
            smooth = 2.0 * float(np.quantile(np.abs(np.diff(middle)), _SMOOTH)) < nearest
            return found if smooth and found.sum() <= few else np.zeros_like(found)
        nearest = min(nearest, float(np.min(distance[far])))
        found[there[far]] = True
        there = there[~far]
    return np.zeros_like(found)
