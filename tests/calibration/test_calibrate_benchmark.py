"""A calibration of a random rig with every effect agrees with its true values."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.long

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
sys.path.append(str(BENCHMARKS))


@pytest.fixture(scope="module")
def outcome() -> Any:
    return runpy.run_path(str(BENCHMARKS / "calibrate.py"))["calibrated"](4)


@pytest.mark.parametrize(
    ("name", "relative", "absolute"),
    [
        ("cv_zero_kPa", 0.0, 0.05),
        ("cv_volume_L", 0.05, 0.0),
        ("pouch_air_SL", 0.05, 0.0),
        ("evp_start", 0.0, 0.02),
        ("evp_flow_resistance_kPa_s_per_SL", 0.05, 0.0),
        ("bottle_leak_kPa_s_per_SL", 0.1, 0.0),
    ],
)
def test_true_values_are_found(outcome: Any, name: str, relative: float, absolute: float) -> None:
    found = outcome.findings.get(name)
    assert found is not None and found.value is not None
    assert found.value == pytest.approx(outcome.truth[name], rel=relative, abs=absolute)


def test_it_takes_less_than_330_s_and_80_kPa(outcome: Any) -> None:
    assert outcome.outcome == "done"
    assert outcome.seconds < 330.0 and outcome.air_kPa < 80.0


def test_no_leak_is_found_where_there_is_none(outcome: Any) -> None:
    found = outcome.findings.get("vine_leak_kPa_s_per_SL")
    assert "vine_leak_kPa_s_per_SL" not in outcome.truth
    assert found.value is None and "none seen" in found.note
