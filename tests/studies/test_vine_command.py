"""`flying-vines vine fit`: output, figures and errors."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from command_line import status

from flying_vines.identification.bend_curve import Law

LOOP = np.concatenate([np.linspace(0.0, 20.7, 20), np.linspace(20.7, 0.0, 20)])


def run(*arguments: object) -> int:
    return status("vine", *arguments)


@pytest.fixture
def pairs(tmp_path: Path) -> Path:
    angles = Law(75.0, 2.5, 11.0, 2.2).angles_deg(LOOP) + np.random.default_rng(1).normal(0.0, 0.5, len(LOOP))
    lines = (f"{kPa:.3f},{deg:.3f}\n" for kPa, deg in zip(LOOP, angles, strict=True))
    path = tmp_path / "pairs.csv"
    path.write_text("pressure_kPa,angle_deg\n" + "".join(lines))
    return path


def test_fit_gives_a_table_for_the_configuration(pairs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("fit", pairs, "--out", pairs.parent / "fit") == 0
    out = capsys.readouterr().out
    assert "[vine]\ncurve = [[0, 0], [2." in out
    assert "95 % interval" in out
    assert (pairs.parent / "fit" / "vine-fit.png").read_bytes().startswith(b"\x89PNG")


def test_fit_as_json(pairs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("fit", "--json", pairs) == 0
    found = json.loads(capsys.readouterr().out)
    low, high = found["hysteresis_kPa"]["low"], found["hysteresis_kPa"]["high"]
    assert low < 2.2 < high
    assert found["vine"]["hysteresis_kPa"] == pytest.approx(found["hysteresis_kPa"]["value"], abs=0.006)
    assert (found["pairs"], found["pairs_up"]) == (40, 21)


def test_bad_input_is_one_line_and_status_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "pairs.csv"
    file.write_text("pressure_kPa,angle_deg\n1,x\n")
    for arguments, words in (
        (["fit", file], ["pairs.csv:2", "'x' is not a number"]),
        (["fit", tmp_path / "none.csv"], ["none.csv"]),
    ):
        assert run(*arguments) == 2
        captured = capsys.readouterr()
        assert captured.out == ""
        assert captured.err.count("\n") == 1
        for word in words:
            assert word in captured.err


def test_the_service_needs_no_numpy() -> None:
    code = (
        "import sys; sys.modules['numpy'] = None\n"
        "import flying_vines.core.core, flying_vines.terminal.vine_sketch\n"
        "from flying_vines.vine import curve, motion, profile, shape"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
