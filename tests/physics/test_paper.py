"""The paper's models and printed data agree with its published numbers."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flying_vines.physics import paper
from flying_vines.physics.gas import ALPHA_KPA
from flying_vines.studies.paper import data
from flying_vines.studies.paper.data import condition, curve, stated

LOW_RESISTANCE = 20.1535 * ALPHA_KPA
DEMONSTRATION = {
    "reservoir_volume_L": 2.0,
    "cv_volume_L": 0.1,
    "swing_kPa": 20.7,
    "flow_resistance_kPa_s_per_SL": LOW_RESISTANCE,
}

pressures = st.floats(1.0, 1000.0)
volumes = st.floats(0.01, 10.0)
resistances = st.floats(50.0, 5000.0)


def test_alpha_is_the_pressure_of_the_standard_state() -> None:
    assert paper.alpha_kPa() == pytest.approx(ALPHA_KPA, rel=1e-4)


def test_a_valve_rated_in_SLPM_has_its_resistance() -> None:
    assert paper.flow_resistance_kPa_s_per_SL(690.0, 23.5) == pytest.approx(1761.7, abs=0.1)
    assert 60.0 * paper.flow_SL_per_s(690.0, LOW_RESISTANCE) == pytest.approx(20.27, abs=0.01)


@pytest.mark.parametrize(
    ("name", "ratio_s_per_L", "volume_L", "tau_s"),
    [
        ("4L_highRv", 26.2547, 4.0, 105.0188),
        ("4L_lowRv", 20.1535, 4.0, 80.6138),
        ("2L_lowRv", 20.1535, 2.0, 40.3069),
    ],
)
def test_the_drawn_discharges_are_equation_3(
    name: str, ratio_s_per_L: float, volume_L: float, tau_s: float
) -> None:
    found = paper.discharge_time_constant_s(ratio_s_per_L * ALPHA_KPA, volume_L)
    assert found == pytest.approx(tau_s, rel=1e-5)
    drawn = curve(f"discharge_{name}_model")
    assert paper.discharge_kPa(drawn.x, float(drawn.y[0]), tau_s) == pytest.approx(drawn.y, rel=5e-6)


@pytest.mark.parametrize(
    ("name", "tau_s", "percent"),
    [("4L_highRv", 105.0188, 4.63), ("4L_lowRv", 80.6138, 4.26), ("2L_lowRv", 40.3069, 5.57)],
)
def test_discharge_nrmse(name: str, tau_s: float, percent: float) -> None:
    measured = curve(f"discharge_{name}_measured")
    off = measured.y - paper.discharge_kPa(measured.x, float(measured.y[0]), tau_s)
    assert 100.0 * np.sqrt(np.mean(off**2)) / measured.y[0] == pytest.approx(percent, abs=0.005)


@pytest.mark.parametrize(("name", "rate"), [("tc1", 68.4), ("tc2", 34.2), ("tc3", 17.1)])
def test_inflation_speeds(name: str, rate: float) -> None:
    test = condition(name)
    found = paper.inflation_rate_kPa_per_s(test.reservoir_kPa, LOW_RESISTANCE, test.cv_volume_L)
    assert found == pytest.approx(rate, abs=0.05)


@pytest.mark.parametrize("name", ["tc4", "tc5"])
def test_the_drawn_frequency_models_are_equation_6(name: str) -> None:
    drawn = curve(f"frequency_model_{name}")
    cutoff = stated()[f"{name}.cutoff_drawn"].value
    assert paper.frequency_gain(drawn.x, cutoff) == pytest.approx(drawn.y, rel=1e-3)


@pytest.mark.parametrize(("name", "decibel"), [("tc4", 3.34), ("tc5", 5.87)])
def test_distance_of_the_frequency_models(name: str, decibel: float) -> None:
    measured = curve(f"frequency_measured_{name}")
    model = paper.frequency_gain(measured.x, stated()[f"{name}.cutoff_drawn"].value)
    off = 20.0 * np.log10(model / measured.y)
    assert np.sqrt(np.mean(off**2)) == pytest.approx(decibel, abs=0.005)


def test_n_cycles_of_the_demonstration() -> None:
    triangle = paper.triangle_rate_kPa_per_s(0.55, 20.7)
    sine = paper.sine_peak_rate_kPa_per_s(0.55, 20.7 / 2.0)
    assert triangle == pytest.approx(22.8, abs=0.05)
    assert sine == pytest.approx(35.8, abs=0.05)
    by_triangle = paper.n_cycles(690.0, rate_kPa_per_s=triangle, **DEMONSTRATION)
    assert by_triangle == pytest.approx(311.0, abs=0.5)
    assert paper.n_cycles(689.5, rate_kPa_per_s=sine, **DEMONSTRATION) == pytest.approx(298.0, abs=0.5)
    more_air = paper.pouch_fill_SL(20.7, 0.1) / paper.rigid_fill_SL(20.7, 0.1)
    assert by_triangle / more_air == pytest.approx(53.0, abs=0.5)


def test_n_cycles_end_where_the_rate_is_out_of_reach() -> None:
    least = paper.min_reservoir_kPa(22.8, LOW_RESISTANCE, 0.1)
    assert least == pytest.approx(45.9, abs=0.1)
    assert paper.n_cycles(least, rate_kPa_per_s=22.8, **DEMONSTRATION) == pytest.approx(0.0, abs=1e-9)
    assert paper.n_cycles(least - 1.0, rate_kPa_per_s=22.8, **DEMONSTRATION) < 0.0


@given(pressures, resistances, volumes)
def test_equation_4_is_1_and_2(reservoir_kPa: float, resistance: float, volume_L: float) -> None:
    through = ALPHA_KPA * paper.flow_SL_per_s(reservoir_kPa, resistance) / volume_L
    rate = paper.inflation_rate_kPa_per_s(reservoir_kPa, resistance, volume_L)
    assert rate == pytest.approx(through, rel=1e-12)
    assert paper.min_reservoir_kPa(rate, resistance, volume_L) == pytest.approx(reservoir_kPa, rel=1e-12)
    back = ALPHA_KPA * paper.flow_for_rate_SL_per_s(rate, volume_L) / volume_L
    assert back == pytest.approx(rate, rel=1e-12)


@given(st.floats(0.1, 1000.0), st.floats(0.1, 100.0))
def test_at_the_cutoff_a_sine_needs_the_greatest_rate(rate: float, amplitude: float) -> None:
    cutoff = paper.cutoff_Hz(rate, amplitude)
    assert paper.sine_peak_rate_kPa_per_s(cutoff, amplitude) == pytest.approx(rate, rel=1e-12)
    assert paper.frequency_gain(cutoff, cutoff) == 1.0
    assert paper.frequency_gain(2.0 * cutoff, cutoff) == pytest.approx(0.5)


@given(st.floats(0.0, 300.0), st.floats(0.01, 20.0))
def test_arrays_and_numbers_give_the_same(time_s: float, frequency_Hz: float) -> None:
    assert paper.discharge_kPa(np.array([time_s]), 690.0, 40.0)[0] == pytest.approx(
        paper.discharge_kPa(time_s, 690.0, 40.0), rel=1e-12
    )
    assert paper.frequency_gain(np.array([frequency_Hz]), 1.36)[0] == pytest.approx(
        paper.frequency_gain(frequency_Hz, 1.36), rel=1e-12
    )


def test_the_models_do_not_import_numpy() -> None:
    code = "import sys, flying_vines.physics.paper as p; p.discharge_kPa(1.0, 690.0, 40.0); "
    code += "p.frequency_gain(1.0, 2.0); sys.exit('numpy' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_every_printed_curve_is_there() -> None:
    files = sorted(path.stem for path in Path(data.__file__).parent.glob("*.csv"))
    points = {name: len(curve(name).x) for name in files}
    assert sorted(points.values()) == [3, 3, 9, 12, 19, 22, 22, 22, 22, 25, 26, 26]
    baseline = curve("frequency_baseline1")
    assert baseline.std is not None
    assert baseline.std[0] == pytest.approx(0.0395691, abs=1e-7)
    assert curve("frequency_measured_tc4").std is None


def test_stated_numbers_have_a_place_and_a_unit() -> None:
    numbers = stated()
    assert numbers["tc1.rate_error"].value == 0.24
    assert numbers["sine.low_supply"].value == 20.0
    assert numbers["mass.total"].value == 1.4
    for key, number in numbers.items():
        assert number.key == key
        assert number.place.startswith(("Sec.", "Fig."))
        assert number.unit
        assert number.says
        assert math.isfinite(number.value) or key == "alpha"
