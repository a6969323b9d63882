"""The measured values in the user's configuration."""

from __future__ import annotations

import tomllib

import pytest

from firmware_link.protocol import Setting
from flying_vines.calibration.configuration import (
    ConfigurationChange,
    calibrated,
    changes,
    proposed,
    with_changes,
    with_numbers,
)
from flying_vines.calibration.findings import Findings, MeasuredQuantity, SettingProposal
from flying_vines.calibration.results import rig_text
from flying_vines.config import config as configuration
from flying_vines.config.config import ConfigError
from flying_vines.physics.plant.true_rig import true_rig_from

DAY = "2026-11-22"
MAX_KPA = 20.7
TEXT = configuration.default_text()
CURVE = ((0.0, 0.0), (3.0, 0.0), (12.04, 41.0), (20.7, 60.04))
FOUND = Findings(
    (
        MeasuredQuantity("cv_noise_kPa", "noise", "kPa", 0.1234, 0.12, 0.13),
        MeasuredQuantity(
            "cv_volume_L",
            "the vine's volume",
            "L",
            0.104321,
            0.1021,
            0.10664,
            assumed=0.1,
            key="pneumatics.cv_volume_L",
        ),
        MeasuredQuantity("vine_leak", "the vine's leak", "kPa·s/SL", note="none seen"),
        MeasuredQuantity(
            "reservoir_volume_L", "the reservoir's", "L", note="believed", key="pneumatics.reservoir_volume_L"
        ),
        MeasuredQuantity(
            "dvp", "unsure", "", 600.0, 100.0, 1100.0, key="pneumatics.dvp_flow_resistance_kPa_s_per_SL"
        ),
        MeasuredQuantity(
            "evp", "none", "", -2.0, -5.0, 1.0, key="pneumatics.evp_flow_resistance_kPa_s_per_SL"
        ),
    ),
    pairs=((0.0, 0.0), (12.0, 41.0), (20.7, 60.0)),
    curve=CURVE,
    hysteresis_kPa=1.25,
)


def test_changed_lines_name_the_old_value_and_all_else_stays() -> None:
    text = with_changes(TEXT, "vine.toml", list(changes(FOUND, MAX_KPA)), DAY)
    before, after = TEXT.split("\n"), text.split("\n")
    assert len(before) == len(after)
    new = [now for was, now in zip(before, after, strict=True) if was != now]
    assert [line.split(" =")[0] for line in new] == ["curve", "hysteresis_kPa", "cv_volume_L"]
    assert "was 0.1, measured 2026-11-22: 0.1021 … 0.1066" in new[2]
    config = configuration.parse(text, "vine.toml")
    assert config.pneumatics.cv_volume_L == 0.1043
    assert config.vine.curve == CURVE
    assert config == with_numbers(configuration.parse(TEXT, "vine.toml"), list(changes(FOUND, MAX_KPA)))


def test_a_second_calibration_replaces_the_comment() -> None:
    once = with_changes(TEXT, "vine.toml", list(changes(FOUND, MAX_KPA)), DAY)
    later = ConfigurationChange("pneumatics", "cv_volume_L", 0.11, "0.108 … 0.112")
    twice = with_changes(once, "vine.toml", [later], "2026-11-23")
    (line,) = [line for line in twice.split("\n") if line.startswith("cv_volume_L")]
    assert "was 0.1043, measured 2026-11-23" in line
    assert DAY not in line


def test_a_curve_that_the_configuration_contradicts_is_a_comment() -> None:
    found = Findings(FOUND.findings, curve=((0.0, 0.0), (20.0, 45.0)))
    text, left_out = calibrated(TEXT, "vine.toml", list(changes(found, MAX_KPA)), DAY)
    assert "bend-full" in left_out
    assert "45" in left_out
    assert "[vine]\n# Measured 2026-11-22, but not used: profiles.bend-full: 60°" in text
    assert "# curve = [[0, 0], [20, 45]]" in text
    config = configuration.parse(text, "vine.toml")
    assert config.vine == configuration.default().vine
    assert config.pneumatics.cv_volume_L == 0.1043


def test_a_curve_ends_at_the_limit() -> None:
    (curve,) = changes(Findings(curve=((0.0, 0.0), (10.0, 40.0), (20.8, 61.6))), MAX_KPA)
    assert curve.value == [[0.0, 0.0], [10.0, 40.0], [20.7, 61.4]]
    configuration.parse(with_changes(TEXT, "vine.toml", [curve], DAY), "vine.toml")


def test_a_configuration_in_one_line_is_not_changed() -> None:
    text = "pneumatics = { full_kPa = 600 }\n[switch]\npositions = ['', '']\n[profiles]\n"
    configuration.parse(text, "vine.toml")
    with pytest.raises(ConfigError, match=r"set pneumatics\.cv_volume_L by hand"):
        with_changes(text, "vine.toml", [ConfigurationChange("pneumatics", "cv_volume_L", 0.1, "")], DAY)


def test_the_rig_files_tolerances_are_the_intervals() -> None:
    numbers = with_numbers(configuration.default(), list(changes(FOUND, MAX_KPA))).pneumatics
    rig = true_rig_from(tomllib.loads(rig_text(numbers, FOUND))).nominal
    assert rig.cv is not None
    assert rig.cv.volume_L == 0.1043
    assert rig.tolerance("cv.volume_L") == pytest.approx(2.2, abs=0.05)
    assert rig.tolerance("reservoir.volume_L") == 1.0
    assert rig.sensors.cv_noise_std_kPa == 0.123


def test_proposals_stay_within_the_firmwares_limits() -> None:
    settings = [
        Setting(0, 2, "cv_zero_kPa", 0.5, -10.0, 10.0, 0.0),
        Setting(1, 2, "evp_dead_band", 0.0, 0.0, 0.6, 0.0),
    ]
    wanted = proposed(
        [
            SettingProposal("cv_zero_kPa", -0.2, True, "zero"),
            SettingProposal("evp_dead_band", 0.7, False, "starts there"),
            SettingProposal("of_another_firmware", 1.0, False, "unknown"),
        ],
        settings,
    )
    assert wanted == {"cv_zero_kPa": 0.3, "evp_dead_band": 0.6}
