"""The day in the life: each step shows what a user needs."""

from __future__ import annotations

from pathlib import Path

import pytest
from real_time import real_time
from required_programs import need

from day.day_in_the_life import LEAK_KPA_S_PER_SL, browser, live

pytestmark = [real_time, pytest.mark.long]
MOST_S = 600.0


def test_a_day_from_the_wheel_to_a_simulation_that_explains_the_rig(tmp_path: Path) -> None:
    need("chromium", "sudo apt install chromium")
    pytest.importorskip("playwright", reason="needs playwright: pip install playwright")
    pytest.importorskip("build", reason="needs build: pip install build")
    home, pictures = tmp_path / "home", tmp_path / "pictures"
    home.mkdir()
    pictures.mkdir()
    with browser() as opened:
        seen = live(home, pictures, opened)

    assert seen.installed.startswith(str(home / "venv"))
    assert "vine.toml: good" in seen.checked
    assert "You may fly" in seen.doctor and "seen in all 3 positions" in seen.doctor

    assert seen.calibrated["outcome"] == "done"
    (leak,) = (found for found in seen.calibrated["findings"] if found["name"] == "vine_leak_kPa_s_per_SL")
    assert leak["low"] < LEAK_KPA_S_PER_SL < leak["high"]

    assert "stores the mission as expected" in seen.uploaded
    assert "item 16: land" in seen.flown
    assert "bend 50°: accepted" in seen.page and "Nothing is wrong" in seen.page
    assert "mission item #6 217 (1, 30, 0, 0) → bend 30°: accepted" in seen.shown
    flight = seen.flight
    assert flight["intents"] == ["reach", "bend 30°", "bend 50°", "straight", "wave"]
    assert flight["altitude_m"] == pytest.approx(15.0, abs=0.5)
    assert flight["peak_kPa"] == pytest.approx(flight["setpoint_kPa"], rel=0.1)
    assert flight["setpoint_kPa"] == pytest.approx(17.6, abs=0.1) and abs(flight["last_kPa"]) < 1.0
    assert "Identical to the flight" in seen.replayed

    assert seen.verdict["cause"] == "cv_leak" and not seen.verdict["also"]
    (found,) = seen.verdict["parameters"].values()
    assert found["estimate"] == pytest.approx(LEAK_KPA_S_PER_SL, rel=0.05)
    assert seen.verdict["held_out"]["nrmse_after"] < seen.verdict["held_out"]["nrmse_before"]
    assert seen.misfit_kPa["extended"] < 0.2 * seen.misfit_kPa["configured"]

    assert sum(seen.seconds.values()) < MOST_S
    assert (
        all(path.stat().st_size > 5000 for path in pictures.iterdir()) and len(list(pictures.iterdir())) > 14
    )
