"""Rig files: content and errors."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from flying_vines.physics.rig import ControlVolume, Rig, RigError, load_rig

WHOLE = """
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


def test_a_whole_file(path: Path) -> None:
    path.write_text(WHOLE)
    rig = load_rig(path)
    assert rig.reservoir.volume_L == 4.0
    assert rig.cv == ControlVolume(volume_L=0.5)
    assert rig.dvp.flow_resistance_kPa_s_per_SL == 600.0
    assert rig.venturi.rated_supply_kPa == 610.0
    assert rig.tolerance("reservoir.volume_L") == 2.5
    assert rig.tolerance("cv.volume_L") == 1.0


def test_without_a_control_volume_the_reservoir_discharges_to_atmosphere(path: Path) -> None:
    path.write_text("[reservoir]\nvolume_L = 4.0\n")
    rig = load_rig(path)
    assert rig.cv is None
    assert rig.evp == Rig().evp


def test_tolerances_may_be_written_as_dotted_keys(path: Path) -> None:
    path.write_text("[tolerance_percent]\nreservoir.volume_L = 3\n")
    assert load_rig(path).tolerance("reservoir.volume_L") == 3.0


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("[reservoir]\nvolume = 2.0", "reservoir.volume"),
        ("[bottle]\nvolume_L = 2.0", "bottle"),
        ("[bottle]", "bottle"),
        ("reservoir = 2.0", "reservoir"),
        ("[reservoir]\nvolume_L = -2.0", "> 0.0"),
        ("[reservoir]\nvolume_L = 0.0", "> 0.0"),
        ("[reservoir]\nvolume_L = inf", "inf"),
        ("[reservoir]\nvolume_L = nan", "nan"),
        ('[reservoir]\nvolume_L = "2"', "reservoir.volume_L"),
        ("[sensors]\ncv_noise_std_kPa = -0.1", ">= 0.0"),
        ('[tolerance_percent]\n"cv.size" = 1', "cv.size"),
        ("[tolerance_percent]\ncv.volume_L = -1", ">= 0.0"),
        ("[reservoir", "cannot be read"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(path: Path, text: str, why: str) -> None:
    path.write_text(text)
    with pytest.raises(RigError) as caught:
        load_rig(path)
    assert why in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there(path: Path) -> None:
    with pytest.raises(RigError, match="cannot be read"):
        load_rig(path)
