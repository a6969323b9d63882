"""Noise that is estimated from residuals: misstated, correlated, rounded."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from flying_vines.identification.noise import SensorNoise, measured_noise, rounding_step, stated_noise
from flying_vines.physics.arrays import Array
from flying_vines.physics.rig import Rig

STATED = SensorNoise(0.15)


def white(seed: int, std_kPa: float = 0.15, count: int = 2250) -> list[Array]:
    rng = np.random.default_rng(seed)
    return [rng.normal(0.0, std_kPa, count) for _ in range(4)]


def correlated(seed: int, rho: float, std_kPa: float = 0.15) -> list[Array]:
    """Noise as after a first-order filter in the sensor."""
    drive = white(seed, std_kPa * np.sqrt(1.0 - rho**2), 3000)
    return [np.asarray(lfilter([1.0], [1.0, -rho], run))[750:] for run in drive]


@pytest.mark.parametrize("seed", range(10))
def test_noise_as_stated_stays_as_stated(seed: int) -> None:
    assert measured_noise(white(seed), STATED) == STATED


@pytest.mark.parametrize("std_kPa", [0.07, 0.3])
def test_misstated_noise_is_measured(std_kPa: float) -> None:
    found = measured_noise(white(1, std_kPa), STATED)
    assert found.std_kPa == pytest.approx(std_kPa, rel=0.05) and found.correlation == 0.0


@pytest.mark.parametrize(("rho", "within"), [(0.5, 0.05), (0.8, 0.07), (0.95, 0.1)])
def test_correlated_noise_is_measured(rho: float, within: float) -> None:
    found = measured_noise(correlated(2, rho), STATED)
    assert found.correlation == pytest.approx(rho, abs=within)
    assert found.std_kPa == pytest.approx(0.15, rel=0.35)


def test_a_mean_over_many_readings_has_the_error_of_the_slow_standard_deviation() -> None:
    noise = SensorNoise(0.15, 0.8)
    means = [run.reshape(-1, 225).mean(axis=1) for seed in range(20) for run in correlated(seed, 0.8)]
    assert np.std(np.concatenate(means)) * np.sqrt(225.0) == pytest.approx(noise.slow_std_kPa, rel=0.1)


def test_a_slope_and_jumps_of_the_residuals_are_no_noise() -> None:
    """An incomplete model: 20 kPa/s at 50 readings a second, and a jump each second."""
    time_s = np.arange(2250) / 50.0
    wrong = [run + 20.0 * time_s + 5.0 * np.floor(time_s) for run in white(3)]
    found = measured_noise(wrong, STATED)
    assert found.std_kPa == pytest.approx(0.15, rel=0.1) and found.correlation == 0.0


def test_a_vibration_is_not_taken_for_more_noise_than_the_residuals_have() -> None:
    time_s = np.arange(2250) / 50.0
    residuals = [run + 1.4 * np.sin(2.0 * np.pi * 5.0 * time_s) for run in white(6)]
    found = measured_noise(residuals, STATED)
    assert found.std_kPa < 1.2 * np.sqrt(1.4**2 / 2.0 + 0.15**2) + 1e-9


def test_few_readings_count_less_than_the_rig_file() -> None:
    assert measured_noise([white(4, 3.0)[0][:50]], STATED) == STATED


def test_rounded_readings_have_at_least_the_noise_of_rounding() -> None:
    level = 650.0 + 0.01 * np.arange(300)
    read = np.round(level / 3.4) * 3.4
    assert rounding_step(read) == pytest.approx(3.4)
    _, reservoir = stated_noise(Rig(), [np.stack((np.full(300, np.nan), read))])
    assert reservoir.std_kPa == pytest.approx(1.2) and reservoir.step_kPa == pytest.approx(3.4)
    assert measured_noise([read - level], reservoir).std_kPa >= 3.4 / np.sqrt(12.0)


def test_readings_with_all_their_digits_have_no_step() -> None:
    assert rounding_step(600.0 * np.exp(-np.arange(100) / 30.0) + white(5)[0][:100]) == 0.0
    assert rounding_step(np.full(100, 3.0)) == 0.0
