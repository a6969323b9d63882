"""The benchmark on measured rigs: independent fits find the parameters of synthetic readings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import measured
import numpy as np
import pytest
from measured_fits import (
    ALPHA_KPA,
    AMBIENT_KPA,
    Array,
    Fitted,
    Readings,
    discharge,
    ideal_nozzle,
    leak,
    pump,
)

VOLUME_L = 0.1
TIME = np.arange(0.0, 60.0, 0.5)


def closed(pressure_kPa: Array) -> Readings:
    noise = 0.05 * np.random.default_rng(1).standard_normal(TIME.size)
    return Readings(TIME, pressure_kPa + noise, np.zeros(TIME.size))


def test_a_leak_by_ohms_law_is_found_by_its_law_and_number() -> None:
    best, *_ = leak(closed(700.0 * np.exp(-ALPHA_KPA * TIME / (VOLUME_L * 2e4))), VOLUME_L)
    assert best.law == "ohm"
    assert best.parameters["flow_resistance_kPa_s_per_SL"] == pytest.approx(2e4, rel=0.002)
    assert best.parameters["volume_times_it"] == pytest.approx(2e3, rel=0.002)
    assert best.rms_kPa == pytest.approx(0.05, rel=0.2)


def test_a_viscous_leak_is_found_by_its_law_and_number() -> None:
    # dP/dt = -k P (P + 2 ambient), separated and integrated.
    k = ALPHA_KPA / (VOLUME_L * 1e7)
    growth = (1.0 + 2.0 * AMBIENT_KPA / 700.0) * np.exp(2.0 * AMBIENT_KPA * k * TIME)
    best, *_ = leak(closed(2.0 * AMBIENT_KPA / (growth - 1.0)), VOLUME_L)
    assert best.law == "viscous"
    assert best.parameters["conductance_constant_kPa2_s_per_SL"] == pytest.approx(1e7, rel=0.002)


def fired(critical: float, wall_s: float, cold_flow: bool) -> Readings:
    """A plenum of 30 cm³ that is fired between two samples, integrated by small Euler steps."""
    time_s = np.arange(0.0, 4.0, 0.1)
    air, warmth, step_s = 760.0, 1.0, 2e-4
    read = np.full(time_s.size, air)
    for i in range(1, time_s.size):
        for t in np.arange(time_s[i - 1], time_s[i] - step_s / 2.0, step_s):
            p = air * warmth
            x = max(0.0, (AMBIENT_KPA / p - critical) / (1.0 - critical))
            flow = 1.02 * ideal_nozzle() * p * np.sqrt(max(0.0, 1.0 - x * x)) * (t >= 0.55)
            gone = ALPHA_KPA * flow / (0.03 * (np.sqrt(warmth) if cold_flow else 1.0))
            warmth += step_s * (-0.289 * warmth * gone / air + (1.0 - warmth) / wall_s)
            air -= step_s * gone
        read[i] = air * warmth
    return Readings(time_s, read - AMBIENT_KPA, (time_s >= 0.55).astype(float))


@pytest.mark.long
@pytest.mark.parametrize("cold_flow", [False, True])
def test_a_discharge_gives_nozzle_ratio_and_wall(cold_flow: bool) -> None:
    found = discharge([fired(0.4, 0.5, cold_flow)], 0.03, cold_flow=cold_flow)
    assert found.rms_kPa < 0.5
    assert found.parameters["of_ideal_nozzle"] == pytest.approx(1.02, rel=0.01)
    assert found.parameters["critical_pressure_ratio"] == pytest.approx(0.4, abs=0.02)
    assert found.parameters["time_constant_s"] == pytest.approx(0.5, rel=0.1)


def test_the_ideal_nozzle_passes_what_tables_of_choked_flow_give() -> None:
    """Isentropic choked flow of CO2 by hand: kg/s at 1 kPa through 0.2827 mm², over kg a standard litre."""
    kg_per_s = 2.827e-7 * 1e3 * np.sqrt(1.289 * 0.04401 / (8.314 * 293.15)) * 0.5859
    assert ideal_nozzle() == pytest.approx(kg_per_s / 1.8297e-3, rel=1e-3)


@pytest.mark.long
def test_a_pump_gives_its_curve_leak_and_lag() -> None:
    time_s = np.arange(0.0, 20.0, 0.05)
    wanted = np.where(time_s % 5.0 < 2.0, 0.3 + 0.6 * (time_s // 5.0) / 3.0, 0.0)
    p, speed, read = 1.0, 0.0, []
    for u in wanted:
        read.append(p)
        for _ in range(50):
            speed += 0.001 / 0.1 * (max(0.0, (u - 0.2) / 0.8) - speed)
            flow = 0.1 * speed * max(0.0, 1.0 - p / 40.0)
            p += 0.001 * ALPHA_KPA / VOLUME_L * (flow - p / 2500.0)
    found = pump([Readings(time_s, np.array(read), wanted)], VOLUME_L).parameters
    assert found["free_flow_SL_per_s"] == pytest.approx(0.1, rel=0.05)
    assert found["stall_kPa"] == pytest.approx(40.0, rel=0.05)
    assert found["opening"] == pytest.approx(0.2, abs=0.02)
    assert found["time_constant_s"] == pytest.approx(0.1, rel=0.1)
    assert found["flow_resistance_kPa_s_per_SL"] == pytest.approx(2500.0, rel=0.05)


def interval(estimate: float, low: float, high: float) -> dict[str, float]:
    return {"estimate": estimate, "low": low, "high": high}


SAID: dict[str, Any] = {
    "cause": "compressible_flow",
    "share": 0.8,
    "parameters": {"critical_pressure_ratio": interval(0.4, 0.35, 0.45)},
    "also": [
        {"cause": "ambient_drop", "share": 0.1, "parameters": {"rate_kPa_per_s": interval(0.3, 0.2, 0.4)}},
        {"cause": "reservoir_cooling", "parameters": {"time_constant_s": interval(5.0, 6.0, 7.0)}},
    ],
}


def test_impossible_values_and_intervals_are_found() -> None:
    assert measured.impossible(SAID) == [
        "ambient_drop rate_kPa_per_s 0.3",
        "reservoir_cooling time_constant_s 5",
    ]


def test_a_parameter_stands_beside_the_independent_one_of_the_same_law() -> None:
    fits = [Fitted("choked, cooling, cold flow", {"critical_pressure_ratio": 0.2}, 1.0)]
    fits.append(Fitted("choked, cooling", {"critical_pressure_ratio": 0.43}, 1.1))
    first, second, *_ = measured.compared(SAID, fits)
    assert first == "compressible_flow 0.4 (0.35 … 0.45), independent 0.43"
    assert second == "ambient_drop 0.3 (0.2 … 0.4)"


def test_of_an_unexplained_case_the_best_try_is_shown() -> None:
    tried = {"cv_leak": {"flow_resistance_kPa_s_per_SL": interval(300.0, 290.0, 310.0)}}
    said = {"cause": "unexplained", "also": [], "ranking": [{"cause": "cv_leak", "parameters": tried}]}
    assert list(measured.compared(said, [])) == ["cv_leak 300 (290 … 310)"]


def test_every_recording_is_imported_by_its_answers(tmp_path: Path) -> None:
    names = []
    for name, files in measured.cases(measured.GROUPS):
        case = measured.imported(files, tmp_path / name)
        assert len(case.runs) == len(files)
        names.append(name)
    assert {"plenum_discharge", "pump_and_chamber", "pump_and_chamber/sweep_kp_15"} <= set(names)


@pytest.mark.long
def test_three_discharges_give_the_ratio_and_the_wall_of_an_independent_fit() -> None:
    """No single cause improves this fit enough. The valve opens between two readings, and readings are
    rounded."""
    *_, (name, files) = measured.cases(["plenum_discharge"])
    looked = measured.look(name, files)
    parameters = {one["cause"]: one["parameters"] for one in measured.named(looked.said)}
    assert looked.said["cause"] == "compressible_flow"
    ratio = parameters["compressible_flow"]["critical_pressure_ratio"]
    independent = next(fit for fit in looked.fits if fit.law == "choked, cooling").parameters
    assert ratio["low"] < independent["critical_pressure_ratio"] < ratio["high"]
    assert ratio["estimate"] == pytest.approx(independent["critical_pressure_ratio"], rel=0.15)
    assert {"reservoir_cooling", "reservoir_sensor_offset"} <= set(parameters)
    assert looked.said["held_out"]["nrmse_after"] < looked.said["held_out"]["nrmse_before"] / 3.0
