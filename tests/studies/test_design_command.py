"""`flying-vines design`: output, figures and errors."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import status

from flying_vines.studies.design import catalogue
from flying_vines.studies.design.robot import example_text


def run(*arguments: str) -> int:
    return status("design", *arguments)


def test_without_options_it_shows_the_demonstration(capsys: pytest.CaptureFixture[str]) -> None:
    assert run() == 0
    out = capsys.readouterr().out
    for words in ("vine of the demonstration", "311", "0.84", "Meets all requirements"):
        assert words in out


def test_the_page_shows_what_the_command_prints(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert run() == 0
    said = [line.rstrip() for line in capsys.readouterr().out.split("\n")]
    page = (Path(__file__).parents[2] / "docs" / "design.md").read_text(encoding="utf-8")
    (shown,) = (block for block in page.split("```") if block.startswith("\nvine of the demonstration"))
    lines = shown.strip().split("\n")
    # The page shows the first table; then the command prints the choices of the catalogue.
    assert lines == said[: len(lines)]
    assert len(lines) > 20


def test_json_has_the_curves_and_the_fronts(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["evaluation"]["cycles"] == pytest.approx(311, abs=0.5)
    assert len(found["evaluation"]["reservoir_kPa"]) == len(found["evaluation"]["inflation_curve_kPa_per_s"])
    assert set(found["fronts"]) == {"cycles", "inflation", "deflation"}
    assert found["robot"]["pressure_kPa"] == 20.7
    assert found["figures"] == []


@pytest.mark.long
def test_it_draws_its_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--out", str(tmp_path / "new")) == 0
    drawn = sorted(path.name for path in (tmp_path / "new").iterdir())
    assert drawn == ["design-search.png", "design-speed.png"]
    for path in (tmp_path / "new").iterdir():
        assert path.read_bytes().startswith(b"\x89PNG")
        assert path.stat().st_size < 150_000
    assert "design-speed.png" in capsys.readouterr().out


@pytest.mark.long
def test_a_robot_that_is_out_of_reach_is_drawn_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "robot.toml"
    changed = example_text().replace("cv_volume_L = 0.1 ", "cv_volume_L = 90.0 ")
    file.write_text(changed.replace('venturi = "coval-vr09f14"', 'venturi = ""').replace("rigid", "pouch", 1))
    assert run("--robot", str(file), "--out", str(tmp_path)) == 0
    out = capsys.readouterr().out
    assert "Does not meet" in out
    assert "No choice of the catalogue" in out


def test_bad_input_is_one_line_and_status_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot = tmp_path / "robot.toml"
    robot.write_text(example_text().replace("fill_kPa = 690.0", "fill_kPa = -690.0"))
    named = tmp_path / "named.toml"
    named.write_text(example_text().replace('evp = "clippard-evp"', 'evp = "clippard"'))
    parts = tmp_path / "parts"
    parts.mkdir()
    (parts / "bottle.toml").write_text('kind = "reservoir"\nname = "b"\nmass_g = { value = 3.0 }\n')
    a_file = tmp_path / "file"
    a_file.write_text("")
    for arguments, words in (
        (["--robot", str(robot)], ["robot.toml:", "fill_kPa"]),
        (["--robot", str(named)], ["named.toml", "parts.evp", "'clippard'"]),
        (["--robot", str(tmp_path / "none.toml")], ["none.toml"]),
        (["--parts", str(parts)], ["bottle.toml:3", "mass_g", "source"]),
        (["--parts", str(tmp_path / "none")], ["none", "no such folder"]),
        (["--out", str(a_file)], [str(a_file)]),
    ):
        assert run(*arguments) == 2
        captured = capsys.readouterr()
        assert captured.out == ""
        assert captured.err.count("\n") == 1
        for word in words:
            assert word in captured.err


def test_parts_are_added_by_folders(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        text = (
            f'kind = "reservoir"\nname = "bottle {name}"\nvolume_L = {{ value = 2.0, source = "s" }}\n'
            f'mass_g = {{ value = 1{len(name)}.0, source = "s" }}\n'
            'max_kPa = { value = 690.0, source = "s" }\n'
        )
        (tmp_path / name / f"{name}.toml").write_text(text)
    assert run("--parts", str(tmp_path / "one"), "--parts", str(tmp_path / "two"), "--json") == 0
    found = json.loads(capsys.readouterr().out)
    names = {part["name"] for e in found["fronts"]["cycles"] for part in e["parts"]}
    assert "bottle one" in names
    assert len(catalogue(tmp_path / "one", tmp_path / "two").parts) == len(catalogue().parts) + 2
