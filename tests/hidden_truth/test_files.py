"""The written files have the recorded data in the public format, without the answer."""

from __future__ import annotations

import csv
import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hidden_truth import draw, make, write
from hidden_truth.effects import EFFECTS
from hidden_truth.examples import example
from hidden_truth.rig import Noise

COLUMNS = [
    "time_s",
    "command_kPa",
    "evp_opening",
    "dvp_opening",
    "solenoid",
    "cv_pressure_kPa",
    "reservoir_pressure_kPa",
]


def table(path: Path) -> tuple[list[str], np.ndarray[tuple[int, int], np.dtype[np.float64]]]:
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    return header, np.array([[float(cell) if cell else np.nan for cell in row] for row in rows])


def test_a_clear_case(tmp_path: Path) -> None:
    truth = draw("clear", 0)
    answer = write(tmp_path / "case_001", truth)
    files = sorted(path.name for path in (tmp_path / "case_001").iterdir())
    assert files == ["rig.toml", "run_1_steps.csv", "run_2_prbs.csv", "run_3_bends.csv", "run_4_hold.csv"]
    for i, run in enumerate(make(truth), start=1):
        header, cells = table(tmp_path / "case_001" / f"run_{i}_{run.name}.csv")
        assert header == COLUMNS
        expected = np.column_stack([run.time_s, run.command_kPa, run.inputs, run.read])
        assert cells == pytest.approx(expected, abs=1e-9, nan_ok=True)
    assert json.loads((tmp_path / "answers.json").read_text(encoding="utf-8")) == {"case_001": answer}
    (hidden,) = truth.hidden
    assert answer["effect"] == hidden.name
    assert answer["parameters"] == {EFFECTS[hidden.name].parameter: hidden.value}
    assert answer["gap"] == truth.gap
    assert hidden.name not in "".join(
        path.read_text(encoding="utf-8") for path in (tmp_path / "case_001").iterdir()
    )


def test_answers_gather_and_a_folder_is_not_written_twice(tmp_path: Path) -> None:
    first, second = example("cv_leak"), replace(example("cv_leak"), hidden=())
    first = replace(first, hidden=(*first.hidden, *example("evp_lag").hidden))
    write(tmp_path / "a", first)
    write(tmp_path / "b", second)
    answers = json.loads((tmp_path / "answers.json").read_text(encoding="utf-8"))
    assert list(answers) == ["a", "b"]
    assert [answers["a"]["effect"], *(also["effect"] for also in answers["a"]["also"])] == [
        one.name for one in first.hidden
    ]
    assert answers["b"]["effect"] == "none"
    assert answers["b"]["parameters"] == {}
    with pytest.raises(FileExistsError):
        write(tmp_path / "a", first)


def test_the_nominal_rig_and_its_tolerance_are_stated(tmp_path: Path) -> None:
    truth = draw("worn", 0)
    write(tmp_path / "case", truth)
    rig = tomllib.loads((tmp_path / "case" / "rig.toml").read_text(encoding="utf-8"))
    assert rig["reservoir"]["volume_L"] == truth.assumed.reservoir_L != truth.rig.reservoir_L
    assert rig["venturi"] == {
        "full_vacuum_kPa": truth.assumed.full_vacuum_kPa,
        "rated_supply_kPa": truth.assumed.rated_supply_kPa,
    }
    assert rig["sensors"]["cv_noise_std_kPa"] == truth.noise.cv_kPa
    assert set(rig["tolerance_percent"].values()) == {2.5}
    assert "evp.flow_resistance_kPa_s_per_SL" in rig["tolerance_percent"]
    assert len(rig["tolerance_percent"]) == 6


def test_a_discharge_is_time_and_reservoir_pressure(tmp_path: Path) -> None:
    write(tmp_path / "case", example("reservoir_leak", "discharge"))
    header, cells = table(tmp_path / "case" / "run_1_discharge.csv")
    assert header == ["time_s", "reservoir_pressure_kPa"]
    assert cells.shape == (900, 2)
    assert "cv" not in tomllib.loads((tmp_path / "case" / "rig.toml").read_text(encoding="utf-8"))


def test_noise_may_be_stated_wrongly(tmp_path: Path) -> None:
    truth = example("cv_leak", stated=Noise(0.3, 0.7))
    write(tmp_path / "case", truth)
    rig = tomllib.loads((tmp_path / "case" / "rig.toml").read_text(encoding="utf-8"))
    assert (
        rig["sensors"]["reservoir_noise_std_kPa"] == truth.stated.reservoir_kPa != truth.noise.reservoir_kPa
    )


def test_holes_are_empty_cells_or_missing_rows(tmp_path: Path) -> None:
    write(tmp_path / "cells", example("cv_leak", "cells"))
    _, cells = table(tmp_path / "cells" / "run_3_bends.csv")
    assert len(cells) == 750
    assert np.isnan(cells[:, 5]).sum() > 110
    assert not np.isnan(cells[:, :5]).any()
    write(tmp_path / "rows", example("cv_leak", "lost"))
    _, cells = table(tmp_path / "rows" / "run_3_bends.csv")
    assert len(cells) < 750 - 100
    assert not np.isnan(cells).any()
    assert np.diff(cells[:, 0]).max() > 2.0


@pytest.mark.parametrize(
    ("variant", "column"),
    [("without_command", "command_kPa"), ("without_cv_pressure", "cv_pressure_kPa")],
)
def test_a_missing_column(tmp_path: Path, variant: str, column: str) -> None:
    write(tmp_path / "case", example("cv_leak", variant))
    header, _ = table(tmp_path / "case" / "run_2_prbs.csv")
    assert header == [name for name in COLUMNS if name != column]
