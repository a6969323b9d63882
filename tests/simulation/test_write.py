"""The case folder, and the command that writes it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from command_line import status
from matplotlib import pyplot as plt

from flying_vines.physics.rig import ControlVolume, Pump, Rig, load_rig
from flying_vines.simulation.scenario import csv_text, simulate
from flying_vines.simulation.scenario.picture import draw_runs
from flying_vines.simulation.scenario.scenario import BendsRun, DischargeRun, OpeningsRun, Valves

RIG = """[reservoir]
volume_L = 2.0
[cv]
volume_L = 0.25
"""
SCENARIO = """
name = "Short"
[[runs]]
kind = "bends"
cycles = 1
[[runs]]
kind = "prbs"
name = "shaken"
duration_s = 2
levels_opening = [0, 0.15, 1]
"""
HEADER = "time_s,command_kPa,evp_opening,dvp_opening,solenoid,cv_pressure_kPa,reservoir_pressure_kPa"


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "believed.toml"
    path.write_text(RIG)
    return path


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    path = tmp_path / "short.toml"
    path.write_text(SCENARIO)
    return path


def run(*arguments: object) -> int:
    return status("simulate", *arguments)


def complaint(capsys: pytest.CaptureFixture[str]) -> str:
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("flying-vines: ")
    return err


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_the_command_makes_a_case_folder(
    rig: Path, scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = tmp_path / "deep" / "case"
    assert run("--rig", rig, "--scenario", scenario, "--out", case, "--seed", 4) == 0
    out = capsys.readouterr().out
    files = contents(case)
    assert set(files) == {"rig.toml", "run_1_bends.csv", "run_2_shaken.csv", "picture.png"}
    assert all(str(case / name) in out for name in files if name != "rig.toml")
    assert files["rig.toml"] == rig.read_bytes()
    assert load_rig(case / "rig.toml") == load_rig(rig)
    assert files["picture.png"].startswith(b"\x89PNG\r\n\x1a\n")
    lines = files["run_1_bends.csv"].decode().split("\n")
    assert lines[0] == HEADER
    assert len(lines) == 1 + 125 + 1
    assert lines[1].startswith("0.000,20.700,0.2083,0,0,")
    assert lines[-2].startswith("2.480,0.000,0,0,")
    assert files["run_2_shaken.csv"].split(b"\n")[1].startswith(b"0.000,,")

    again, other = tmp_path / "again", tmp_path / "other"
    run("--rig", rig, "--scenario", scenario, "--out", again, "--seed", 4)
    run("--rig", rig, "--scenario", scenario, "--out", other, "--seed", 5)
    assert contents(again) == files
    assert all(contents(other)[name] != files[name] for name in files if name.endswith(".csv"))
    # The same folder is written again.
    assert run("--rig", rig, "--scenario", scenario, "--out", other, "--seed", 4) == 0
    assert contents(other) == files


def test_numbers_are_written_plainly() -> None:
    text = csv_text(simulate(Rig(), OpeningsRun(valves=(Valves(for_s=0.04, evp=0.00012, dvp=0.00004),))))
    assert text.split("\n")[1].split(",")[:5] == ["0.000", "", "0.0001", "0", "0"]
    assert "-0.000," not in csv_text(simulate(Rig(), BendsRun(cycles=1, hold_s=0.5, rest_s=5.0)))


def test_without_a_control_volume_there_is_no_column_for_it() -> None:
    text = csv_text(simulate(Rig(cv=None), DischargeRun(duration_s=0.04)))
    assert text.split("\n")[0] == HEADER.replace("cv_pressure_kPa,", "")
    assert all(line.count(",") == 5 for line in text.split("\n")[:-1])


def test_a_rig_without_reservoir_or_volume_gets_no_panel_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    figures: list[Any] = []
    monkeypatch.setattr(plt, "close", figures.append)
    pumped = simulate(Rig(pump=Pump()), OpeningsRun(valves=(Valves(for_s=0.04, evp=1.0),)))
    draw_runs([pumped], tmp_path / "pumped.png", "A pump")
    discharged = simulate(Rig(cv=None), DischargeRun(duration_s=0.04))
    draw_runs([discharged], tmp_path / "discharged.png", "A discharge")
    panels = [[axis.get_ylabel() for axis in figure.axes] for figure in figures]
    assert panels == [["kPa gauge", ""], ["", "reservoir,\nkPa gauge"]]
    assert all(figure.axes[-1].get_xlabel() == "time, s" for figure in figures)


def test_cases_are_not_mixed(
    rig: Path, scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "run_3_hold.csv").touch()
    assert run("--rig", rig, "--scenario", scenario, "--out", tmp_path / "a") == 2
    assert "contains run_3_hold.csv, which is not a run of this scenario" in complaint(capsys)
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "rig.toml").write_text("# another")
    assert run("--rig", rig, "--scenario", scenario, "--out", tmp_path / "b") == 2
    assert "differs from the simulated rig" in complaint(capsys)
    assert (tmp_path / "b" / "rig.toml").read_text() == "# another"


def test_a_rig_may_stand_in_its_case_folder(scenario: Path, tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(RIG)
    assert run("--rig", tmp_path / "rig.toml", "--scenario", scenario, "--out", tmp_path) == 0
    assert (tmp_path / "rig.toml").read_text() == RIG


@pytest.mark.long
def test_the_answer_is_kept_apart(scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = tmp_path / "hidden.toml"
    rig.write_text(RIG + "[causes.cv_leak]\nflow_resistance_kPa_s_per_SL = 300\n[effects]\nlikely = true\n")
    case = tmp_path / "case"
    assert run("--rig", rig, "--scenario", scenario, "--out", case) == 0
    assert load_rig(case / "rig.toml") == Rig(cv=ControlVolume(0.25))
    assert b"cause" not in (case / "rig.toml").read_bytes()
    assert (case / "truth.toml").read_bytes() == rig.read_bytes()
    assert run("--rig", rig, "--scenario", scenario, "--out", case) == 0
    capsys.readouterr()
    rig.write_text(RIG + "[causes.cv_leak]\nflow_resistance_kPa_s_per_SL = 400\n")
    assert run("--rig", rig, "--scenario", scenario, "--out", case) == 2
    assert f"{case / 'truth.toml'}: exists already and differs" in complaint(capsys)


def test_bad_input_is_one_line(
    rig: Path, scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    bad = tmp_path / "bad.toml"
    bad.write_text('[[runs]]\nkind = "bends"\ncycles = 0\n')
    leek = tmp_path / "leek.toml"
    leek.write_text("[cv]\n[causes.cv_leek]\n")
    no_cv = tmp_path / "no_cv.toml"
    no_cv.write_text("")
    for arguments, says in (
        ((rig, bad), f"{bad}:3: runs[0].cycles: must be a whole number from 1 to 1000, not 0"),
        ((rig, "casse"), "casse: no such file and no such example; the examples are case, discharge"),
        ((tmp_path / "none.toml", scenario), "none.toml: cannot be read"),
        ((leek, scenario), f"{leek}:2: causes.cv_leek is not a cause: the causes are none, "),
        ((no_cv, scenario), f"{scenario}: runs[0]: bends needs a control volume, and the rig has no [cv]"),
    ):
        assert run("--rig", arguments[0], "--scenario", arguments[1], "--out", out) == 2
        assert says in complaint(capsys)
    assert not out.exists()
    assert run("--rig", rig, "--scenario", scenario, "--out", rig) == 2
    assert str(rig) in complaint(capsys)
