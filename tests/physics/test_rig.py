"""Rig files: content and errors."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from flying_vines.physics.rig import ControlVolume, Rig, RigError, load_rig

COMPLETE = """
[reservoir]
volume_L = 4.0
[cv]
volume_L = 0.5
[evp]
flow_resistance_kPa_s_per_SL = 2000.0
[dvp]
flow_resistance_kPa_s_per_SL = 600
[solenoid]
flow_resistance_kPa_s_per_SL = 71.0
[venturi]
full_vacuum_kPa = 50.0
rated_supply_kPa = 610.0
[sensors]
cv_noise_std_kPa = 0.1
reservoir_noise_std_kPa = 0.0
[tolerance_percent]
"reservoir.volume_L" = 2.5
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "rig.toml"


def test_the_nominal_rig() -> None:
    rig = Rig()
    assert rig.reservoir.volume_L == 2.0
    assert rig.cv == ControlVolume(volume_L=0.1)
    assert rig.evp.flow_resistance_kPa_s_per_SL == 2042.0
    assert rig.dvp.flow_resistance_kPa_s_per_SL == 618.0
    assert rig.solenoid.flow_resistance_kPa_s_per_SL == 70.0
    assert (rig.venturi.full_vacuum_kPa, rig.venturi.rated_supply_kPa) == (55.0, 600.0)
    assert (rig.sensors.cv_noise_std_kPa, rig.sensors.reservoir_noise_std_kPa) == (0.15, 1.2)


def test_a_rig_cannot_be_changed_in_place() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        Rig().reservoir.volume_L = 3.0  # type: ignore[misc]
    assert dataclasses.replace(Rig(), cv=None).cv is None


def test_a_complete_file(path: Path) -> None:
    path.write_text(COMPLETE)
    rig = load_rig(path)
    assert rig.reservoir.volume_L == 4.0
    assert rig.cv == ControlVolume(volume_L=0.5)
    assert rig.dvp.flow_resistance_kPa_s_per_SL == 600.0
    assert rig.venturi.rated_supply_kPa == 610.0
    assert rig.tolerance("reservoir.volume_L") == 2.5
    assert rig.tolerance("cv.volume_L") == 1.0


def test_a_rig_file_without_cv_has_no_control_volume(path: Path) -> None:
    path.write_text("[reservoir]\nvolume_L = 4.0\n")
    rig = load_rig(path)
    assert rig.cv is None
    assert rig.evp == Rig().evp


def test_tolerances_may_be_written_as_dotted_keys(path: Path) -> None:
    path.write_text("[tolerance_percent]\nreservoir.volume_L = 3\n")
    assert load_rig(path).tolerance("reservoir.volume_L") == 3.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "[reservoir]\nvolume = 2.0",
            "unknown key 'reservoir.volume' of a rig: use reservoir.volume_L.",
        ),
        ("[venturi]\nfull_vacum_kPa = 50", "use venturi.full_vacuum_kPa, venturi.rated"),
        (
            "[sensors]\ntank_noise_std_kPa = 1",
            "use sensors.cv_noise_std_kPa, sensors.reservoir_noise",
        ),
        ("[tank]\nvolume_L = 2.0", "unknown table 'tank' of a rig: use reservoir, cv, "),
        ("[resevoir]", "did you mean reservoir?"),
        ("reservoir = 2.0", "reservoir must be a table: write [reservoir], and its keys on the lines below."),
        ("tolerance_percent = 2.0", "tolerance_percent must be a table"),
        ("[[cv]]\nvolume_L = 0.1", "cv must be a table"),
        ("[reservoir]\nvolume_L = -2.0", "reservoir.volume_L must be a number from 0.001 to 1000, not -2.0."),
        ("[reservoir]\nvolume_L = 0.0", "from 0.001 to 1000, not 0.0."),
        ("[reservoir]\nvolume_L = inf", "inf"),
        ("[reservoir]\nvolume_L = nan", "nan"),
        (
            '[reservoir]\nvolume_L = "2 L"',
            "reservoir.volume_L must be a number from 0.001 to 1000, not '2 L'.",
        ),
        ("[cv]\nvolume_L = true", "cv.volume_L must be a number from 0.0001 to 50, not True."),
        (
            "[sensors]\ncv_noise_std_kPa = -0.1",
            "sensors.cv_noise_std_kPa must be a number from 0 to 1000, not -0.1.",
        ),
        (
            "[venturi]\nfull_vacuum_kPa = 300",
            "venturi.full_vacuum_kPa must be a number from 0 to 101.325, not 300.",
        ),
        ('[tolerance_percent]\n"cv.size" = 1', "unknown key 'tolerance_percent.cv.size' of a rig"),
        (
            "[tolerance_percent]\ncv.volume_L = -1",
            "tolerance_percent.cv.volume_L must be a number from 0 to 10000, not -1.",
        ),
        (
            "[cv]\n[pump]\n[reservoir]",
            "a rig with a [pump] has no [reservoir], because the pump takes its place",
        ),
        ("[pump]", "a pump or a hose needs a control volume: add [cv] with its volume_L."),
        ("[hose]", "a pump or a hose needs a control volume"),
        ("[gas]\nname = 'steam'", "gas: 'steam' is not a known gas: the gases are air, N2,"),
        ("[gas]\ngamma = 1.3", "gas: a gas with its own numbers needs both gamma and molar_mass_g_per_mol."),
        ("[gas]\ngamma = 0.9\nmolar_mass_g_per_mol = 4", "gas: gamma of a gas must be between 1 and 5/3"),
        ("[reservoir", "rig.toml:1: not TOML"),
    ],
)
def test_each_error_is_one_line_with_the_path(path: Path, text: str, message: str) -> None:
    path.write_text(text)
    with pytest.raises(RigError) as caught:
        load_rig(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file(path: Path) -> None:
    with pytest.raises(RigError, match="cannot be read"):
        load_rig(path)
