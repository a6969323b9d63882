"""Wrong robot files and parts give one line with file and key; and the built-in data."""

from __future__ import annotations

from pathlib import Path

import pytest

from flying_vines.config.config import ConfigError
from flying_vines.studies.design import catalogue
from flying_vines.studies.design import robot as requirements
from flying_vines.studies.design.parts import Number, ValvePart, parse

VALVE = """kind = "valve"
name = "mine"
flow_SLPM = { value = 30.0, source = "the maker" }
at_kPa = { value = 690.0, source = "the maker" }
max_inlet_kPa = { value = 690.0, source = "the maker" }
mass_g = { value = 50.0, source = "my scales" }
"""
ROBOT = 'name = "r"\ncv_volume_L = 0.2\npressure_kPa = 20.0\nfrequency_Hz = 0.5\npayload_kg = 1.5\n'


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("value = 50.0", "value = -50.0", ["v.toml:6: mass_g.value", "from 0 to"]),
        ("value = 50.0", "value = nan", ["v.toml:6: mass_g"]),
        ("value = 50.0", "value = inf", ["v.toml:6: mass_g"]),
        ("value = 30.0", "value = 0.0", ["v.toml:3: flow_SLPM", "above 0"]),
        (', source = "my scales"', "", ["v.toml:6: mass_g", "source is missing"]),
        ('source = "my scales"', "assumed = true", ["v.toml:6: mass_g", "note"]),
        (
            'source = "my scales"',
            'source = "s", assumed = true',
            ["v.toml:6: mass_g", "assumed = true: remove one"],
        ),
        ("mass_g", "mas_g", ["v.toml", "mas_g"]),
        ("value = 50.0", "valeu = 50.0", ["v.toml:6: mass_g", "valeu"]),
        ('kind = "valve"', 'kind = "pump"', ["v.toml:1: kind", "pump"]),
        ('kind = "valve"\n', "", ["v.toml", "kind"]),
        ('name = "mine"', "name = 7", ["v.toml:2: name"]),
        ('name = "mine"', 'name = "mine', ["v.toml", "not TOML"]),
    ],
)
def test_a_wrong_part_is_one_line(old: str, new: str, words: list[str]) -> None:
    assert old in VALVE
    with pytest.raises(ConfigError) as raised:
        parse(VALVE.replace(old, new), "v.toml")
    text = str(raised.value)
    assert "\n" not in text
    for word in words:
        assert word in text, text


def test_an_unknown_key_gets_a_suggestion() -> None:
    with pytest.raises(
        ConfigError, match=r"v.toml:7: max_inlet_kpa: unknown key; did you mean 'max_inlet_kPa'"
    ):
        parse(VALVE + 'max_inlet_kpa = { value = 1.0, source = "s" }\n', "v.toml")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("0.2", "-0.2", ["r.toml:2: cv_volume_L"]),
        ("0.2", "nan", ["r.toml", "cv_volume_L"]),
        ("frequency_Hz = 0.5\n", "", ["frequency_Hz", "inflation_rate_kPa_per_s"]),
        ("0.5", "0.5\ninflation_rate_kPa_per_s = 20.0", ["either"]),
        ("0.5", "0.5\npeak_to_peak_kPa = 30.0", ["peak_to_peak_kPa is above"]),
        ("0.5", '0.5\ncv_kind = "pouch"\npeak_to_peak_kPa = 10.0', ["pouch"]),
        ("cv_volume_L", "cv_volume_l", ["r.toml", "cv_volume"]),
        ("payload_kg = 1.5\n", "", ["'payload_kg' is missing"]),
        ("payload_kg = 1.5\n", "payload_kg = 1.5\n[parts]\nreservoirs = 0\n", ["r.toml:7: parts.reservoirs"]),
    ],
)
def test_a_wrong_robot_is_one_line(old: str, new: str, words: list[str]) -> None:
    assert old in ROBOT
    with pytest.raises(ConfigError) as raised:
        requirements.parse(ROBOT.replace(old, new, 1), "r.toml")
    text = str(raised.value)
    assert "\n" not in text
    for word in words:
        assert word in text, text


def test_a_part_that_no_file_has_is_named() -> None:
    robot = requirements.parse(ROBOT + '[parts]\nevp = "pet-2.0"\n', "r.toml")
    with pytest.raises(
        ConfigError, match=r"r.toml: parts.evp: 'pet-2.0' is not in the catalogue.* clippard-evp"
    ):
        catalogue().choose(robot.parts, "r.toml")


def test_a_folder_adds_and_replaces_parts(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(VALVE)
    (tmp_path / "clippard-evp.toml").write_text(VALVE.replace("mine", "better"))
    (tmp_path / "notes.txt").write_text("not a part")
    found = catalogue(tmp_path)
    assert len(found.parts) == len(catalogue().parts) + 1
    assert found.choose().evp.name == "better"
    assert found.choose().evp.resistance_kPa_s_per_SL == pytest.approx(60 * 690 / 30)
    with pytest.raises(ConfigError, match="no such folder"):
        catalogue(tmp_path / "none")


def test_every_built_in_number_has_a_source() -> None:
    numbers = [
        (name, key, value)
        for name, part in catalogue().parts.items()
        for key in part.__struct_fields__
        if isinstance(value := getattr(part, key), Number)
    ]
    assert len(numbers) > 60
    for name, key, value in numbers:
        words = value.note if value.assumed else value.source
        assert value.assumed or words.startswith(("paper, ", "computed from")), (name, key)


def test_variants_by_orifice_scale_with_its_area() -> None:
    parts = catalogue().parts
    rated = parts["clippard-evp"]
    assert isinstance(rated, ValvePart)
    for name, inch in (("013", 0.013), ("020", 0.020), ("040", 0.040)):
        variant = parts[f"evp-orifice-{name}"]
        assert isinstance(variant, ValvePart)
        assert variant.flow_SLPM.origin == "computed"
        expected = rated.flow_SLPM.value * (inch / 0.025) ** 2
        assert variant.flow_SLPM.value == pytest.approx(expected, rel=0.005)
