"""The command `diagnose`: a verdict for people and machines, one line for each error."""

from __future__ import annotations

import json
from pathlib import Path

import command_line
import pytest
from hidden_truth import draw

from flying_vines.identification.case import read_case
from flying_vines.identification.diagnose import diagnose
from flying_vines.physics.effects import catalogue
from flying_vines.physics.plant.effects import Effects
from flying_vines.physics.plant.true_rig import load_true_rig


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    return command_line.run(capsys, "diagnose", *arguments)


def test_json_is_one_object_of_the_format_and_the_extended_rig_can_be_simulated(
    short_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, _ = run(capsys, str(short_folder), "--json", "--write-rig", str(tmp_path / "extended.toml"))
    assert status == 0
    verdict = json.loads(out)
    assert verdict["cause"] == draw("short", 1).hidden[0].name
    assert 0.0 <= verdict["confidence"] <= 1.0
    (estimate,) = verdict["parameters"].values()
    assert estimate["low"] <= estimate["estimate"] <= estimate["high"]
    assert set(verdict["held_out"]) == {"nrmse_before", "nrmse_after", "noise_floor", "gain"}
    low, high = verdict["held_out"]["gain"]
    assert 0.0 < low < high < 1.0
    best = verdict["ranking"][0]
    assert (best["cause"], best["score"], best["on_bound"]) == (verdict["cause"], 0.0, [])
    assert best["unseen_nrmse"] == verdict["held_out"]["nrmse_after"]
    ((rough,),) = (parameters.values() for parameters in best["parameters"].values())
    assert rough["estimate"] == estimate["estimate"]
    assert rough["high"] - rough["low"] == pytest.approx(estimate["high"] - estimate["low"], rel=0.2)
    assert verdict["also"] == [] and isinstance(verdict["next_experiment"], str)
    rig = load_true_rig(tmp_path / "extended.toml")
    (value,) = rig.causes[verdict["cause"]].values()
    assert value == pytest.approx(estimate["estimate"])
    assert rig.setup.plant.effects != Effects() or rig.setup.plant.rig != rig.nominal


@pytest.mark.long
def test_the_text_names_the_cause_and_its_evidence(
    short_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, _ = run(capsys, str(short_folder))
    assert status == 0
    assert draw("short", 1).hidden[0].name in out
    assert "Unseen data" in out and "noise alone" in out


def test_an_unreadable_input_gives_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "rig.toml").write_text("[cv]\nvolume_L = 0.1\n")
    assert str(tmp_path) in command_line.refused(capsys, "diagnose", tmp_path)


def test_a_rig_file_with_a_mistake_is_one_line(
    short_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "other.toml"
    rig.write_text("[reservoir]\nvolume_L = -2\n")
    line = command_line.refused(capsys, "diagnose", short_folder, "--rig", rig)
    assert "other.toml" in line and "volume_L" in line


def test_one_cause_or_none_gives_a_verdict(short_folder: Path) -> None:
    read = read_case(short_folder)
    (hidden,) = draw("short", 1).hidden
    by_name = {cause.name: cause for cause in catalogue()}
    assert diagnose(read, [by_name[hidden.name]]).cause == hidden.name
    for considered in ([], [by_name["reservoir_leak"]]):
        assert diagnose(read, considered).cause == "unexplained"
