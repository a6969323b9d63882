"""Readings of a true pressure: errors, lag, noise and range."""

from __future__ import annotations

import math
import random
import statistics

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flying_vines.physics.plant.sensors import HONEYWELL_15BAR, HONEYWELL_30PSI, Adc, Sensor, read, rested


def reading(sensor: Sensor, kPa: float, noise: float = 0.0) -> float:
    return read(sensor, rested(kPa), kPa, 0.001, noise)[1]


@given(st.floats(-100.0, 2000.0))
def test_a_perfect_sensor(kPa: float) -> None:
    assert reading(Sensor(), kPa) == kPa


def test_gain_offset_and_noise() -> None:
    assert reading(Sensor(offset_kPa=2.0, gain=1.1), 10.0) == pytest.approx(13.2)
    assert reading(Sensor(noise_std_kPa=0.15), 10.0, 2.0) == pytest.approx(10.3)
    rng = random.Random(1)
    seen = [reading(Sensor(noise_std_kPa=0.5), 10.0, rng.gauss(0.0, 1.0)) for _ in range(4000)]
    assert statistics.stdev(seen) == pytest.approx(0.5, rel=0.05)


def test_steps_as_computed_from_the_data_sheets() -> None:
    """Pressure per code: 4 V span, 3.3 V reference; 30 psi and 15 bar; 10, 12, 16 bits."""
    for bits, small, large in ((10, 0.167, 1.21), (12, 0.042, 0.302), (16, 0.0026, 0.019)):
        assert Adc(bits).step_kPa(206.84) == pytest.approx(small, rel=0.02)
        assert Adc(bits).step_kPa(1500.0) == pytest.approx(large, rel=0.02)


def test_the_converter_ends_below_the_sensor() -> None:
    assert reading(Sensor(206.84, adc=Adc()), 200.0) == pytest.approx(145.0, abs=0.5)
    assert reading(Sensor(1500.0, adc=Adc()), 1400.0) == pytest.approx(1050.0, abs=1.5)
    divided = Sensor(206.84, adc=Adc(divider=0.7))
    assert reading(divided, 200.0) == pytest.approx(200.0, abs=0.2)


@given(st.floats(-20.0, 140.0), st.sampled_from([10, 12, 16]))
def test_a_code_is_the_nearest(kPa: float, bits: int) -> None:
    sensor = Sensor(206.84, adc=Adc(bits))
    assert sensor.adc is not None
    step_kPa = sensor.adc.step_kPa(206.84)
    seen = reading(sensor, kPa)
    assert abs(seen - kPa) <= step_kPa / 2.0 + 1e-9
    assert reading(sensor, seen) == pytest.approx(seen, abs=1e-9)
    code = sensor.adc.code(kPa, 206.84)
    assert seen == sensor.adc.pressure_kPa(code, 206.84)
    assert 0 <= code < 1 << bits


def test_the_ends_of_the_range() -> None:
    assert reading(HONEYWELL_30PSI, -50.0) == pytest.approx(-19.39, abs=0.01)
    assert reading(HONEYWELL_30PSI, 400.0) == pytest.approx(226.2, abs=0.1)
    assert reading(HONEYWELL_15BAR, 690.0) == 690.0
    assert Adc().code(-500.0, 206.84) == 0
    assert Adc().code(5000.0, 206.84) == 1023


def test_a_step_is_followed_with_the_time_constant() -> None:
    sensor = Sensor(time_constant_s=0.02)
    seen = rested(0.0)._replace(true_kPa=10.0)
    for _ in range(20):
        seen, kPa = read(sensor, seen, 10.0, 0.001)
    assert kPa == pytest.approx(10.0 * (1.0 - math.exp(-1.0)), rel=1e-12)


def test_a_ramp_is_followed_behind_by_rate_times_time_constant() -> None:
    sensor = Sensor(time_constant_s=0.01)
    seen = rested(0.0)
    for tick in range(1, 301):
        t_s = tick / 1000.0
        seen, kPa = read(sensor, seen, 50.0 * t_s, 0.001)
        assert kPa == pytest.approx(50.0 * (t_s - 0.01 * (1.0 - math.exp(-t_s / 0.01))), abs=1e-9)


def test_no_time_no_change() -> None:
    seen, kPa = read(Sensor(time_constant_s=0.01), rested(3.0), 9.0, 0.0)
    assert (kPa, seen.lagged_kPa) == (3.0, 3.0)


def test_what_cannot_be() -> None:
    for bad in (
        lambda: Adc(0),
        lambda: Adc(reference_V=0.0),
        lambda: Sensor(0.0),
        lambda: Sensor(noise_std_kPa=-1.0),
    ):
        with pytest.raises(ValueError, match=r"\w"):
            bad()
