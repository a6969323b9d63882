"""The paper reproduced: the table, the closed loop behind it, and the command."""

from __future__ import annotations

import io
import json
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import status
from rich.console import Console

import flying_vines.studies.paper
from flying_vines.physics.rig import ControlVolume, Rig
from flying_vines.studies.paper import PaperComparison, as_json, compare
from flying_vines.studies.paper.bench import LIKELY, Bench, follow_sine, gain, run
from flying_vines.studies.paper.compare import last_crossing_Hz, window_s
from flying_vines.studies.paper.figures import draw
from flying_vines.studies.paper.report import show

pytestmark = pytest.mark.long

PAGE = Path(__file__).parents[2] / "docs" / "paper.md"
TABLE = Path(__file__).with_name("paper_table.txt")
PNG = b"\x89PNG\r\n\x1a\n"
FIGURES = {f"paper-{name}.png" for name in ("discharge", "inflation", "frequency", "sine", "cycles")}


@pytest.fixture(scope="module")
def comparison() -> PaperComparison:
    return compare()


@pytest.fixture
def quick(comparison: PaperComparison, monkeypatch: pytest.MonkeyPatch) -> None:
    """The command, with the results that this module has already computed."""
    monkeypatch.setattr(flying_vines.studies.paper, "compare", lambda: comparison)


def test_every_difference_has_a_reason(comparison: PaperComparison) -> None:
    assert len({row.key for row in comparison.rows}) == len(comparison.rows)
    for row in comparison.rows:
        assert row.verdict == "agrees" or row.note, row.key
        assert row.quantity
        assert row.place


def test_the_venturi_rests_in_the_demonstration() -> None:
    trace = run(
        Bench().with_cv(0.1),
        lambda t: 20.7 * (1.0 - abs(1.0 - 2.0 * (0.55 * t % 1.0))),
        reservoir_kPa=690.0,
        duration_s=4.0,
    )
    assert trace["dvp"].max() == 0.0
    assert np.ptp(trace["cv_reading_kPa"]) == pytest.approx(20.7, rel=0.05)


def test_a_slow_sine_is_followed_and_a_supply_does_not_fall() -> None:
    bench = Bench().with_cv(0.5).with_fixed_source()
    trace = follow_sine(bench, frequency_Hz=0.5, peak_to_peak_kPa=21.0, reservoir_kPa=690.0)
    assert gain(trace, 2) == pytest.approx(1.0, abs=0.1)
    assert trace["reservoir_kPa"][-1] == pytest.approx(690.0, abs=1e-5)


@pytest.mark.parametrize("cycles", [1, 3])
def test_gain_is_the_fundamentals(cycles: int) -> None:
    turns = np.arange(300) / 300.0 * cycles
    command = np.sin(2.0 * np.pi * turns)
    # A square's fundamental is 4/π of its height.
    square = 5.0 + 0.5 * np.sign(np.sin(2.0 * np.pi * (turns + 1e-9)))
    trace = np.zeros(300, [("target_kPa", float), ("cv_reading_kPa", float)])
    trace["target_kPa"], trace["cv_reading_kPa"] = command, square
    assert gain(trace, cycles) == pytest.approx(2.0 / np.pi, rel=1e-3)


def test_crossings() -> None:
    x = np.array([1.0, 4.0, 2.0, 2.0])
    assert last_crossing_Hz(x, np.array([2.0, 0.5, 1.5, 2.5]), 1.0) == pytest.approx(2.0 * 2.0**0.5)
    assert np.isnan(last_crossing_Hz(x, np.array([0.5, 0.5, 0.5, 0.5]), 1.0))
    assert np.isnan(last_crossing_Hz(x, np.array([2.0, 2.0, 2.0, 2.0]), 1.0))


@pytest.mark.parametrize("ratio", [0.55, 0.8, 1.25, 1.45])
def test_window_of_two_ramps(ratio: float) -> None:
    """The nRMSE of two sampled ramps over that window."""
    window = window_s(1.0, ratio, 0.1)
    t = np.linspace(0.0, window, 200_001)
    off = np.minimum(ratio * t, 1.0) - np.minimum(t, 1.0)
    assert np.sqrt(np.mean(off**2)) == pytest.approx(0.1, rel=1e-3)
    assert np.isnan(window_s(1.0, 1.0 + (ratio - 1.0) / 50.0, 0.1))


@pytest.mark.parametrize("duration_s", [0.0, -1.0, float("nan"), float("inf")])
def test_a_test_lasts_a_time(duration_s: float) -> None:
    with pytest.raises(ValueError, match="must be positive"):
        run(Bench(), lambda _: 0.0, reservoir_kPa=690.0, duration_s=duration_s)


def test_a_sine_has_a_frequency_and_a_loop_a_volume() -> None:
    with pytest.raises(ValueError, match="must be positive"):
        follow_sine(Bench(), frequency_Hz=0.0, peak_to_peak_kPa=1.0, reservoir_kPa=690.0)
    with pytest.raises(ValueError, match="control volume"):
        run(Bench(rig=Rig(cv=None)), lambda _: 0.0, reservoir_kPa=690.0, duration_s=1.0)
    assert Bench().with_cv(1.0).rig.cv == ControlVolume(1.0)


def test_json_has_the_documented_keys(comparison: PaperComparison) -> None:
    found = json.loads(json.dumps(as_json(comparison), allow_nan=False))
    page = PAGE.read_text(encoding="utf-8")
    keys = set(found)
    for part in found.values():
        for item in part if isinstance(part, list) else [part]:
            keys |= set(item) if isinstance(item, dict) else set()
    assert {key for key in keys if f"`{key}`" not in page} == set()
    assert len(found["rows"]) == len(comparison.rows)
    assert [f["supply_kPa"] for f in found["frequency"]] == [690.0, 345.0, 690.0]


def cells(line: str) -> list[str]:
    return re.split(r"\s{2,}", line.strip())


def test_the_table_is_as_it_was(comparison: PaperComparison) -> None:
    printed = io.StringIO()
    show(comparison.rows, (), Console(file=printed, width=160))
    ours = [cells(line) for line in printed.getvalue().split("\n")[: 1 + len(comparison.rows)]]
    stored = [cells(line) for line in TABLE.read_text(encoding="utf-8").strip().split("\n")]
    assert [line[0] for line in ours] == [line[0] for line in stored]
    for row, mine, text in zip(comparison.rows, ours[1:], stored[1:], strict=True):
        if row.by not in ("plant", "high-fidelity"):
            assert mine == text
            continue
        assert (mine[2], mine[-1]) == (text[2], text[-1]), row.key
        # Where a plant switches, the last bits depend on the compiler.
        assert float(mine[3]) == pytest.approx(float(text[3]), rel=0.03, abs=0.02), row.key


def test_the_page_has_rows_of_the_table_and_the_counts(comparison: PaperComparison) -> None:
    page = PAGE.read_text(encoding="utf-8")
    shown = page.split("```")[1].strip().split("\n")
    assert len(shown) > 30
    assert set(shown) <= set(TABLE.read_text(encoding="utf-8").split("\n"))
    counts = Counter(row.verdict for row in comparison.rows)
    agree, differ, undecided = (counts[verdict] for verdict in ("agrees", "differs", "undecided"))
    assert f"\n{agree} agree, {differ} differ, {undecided} cannot be decided.\n" in page


def test_the_page_has_todays_distances(comparison: PaperComparison) -> None:
    page = PAGE.read_text(encoding="utf-8")
    likely = comparison.curves.likely_frequencies
    for baseline, f in zip(comparison.curves.frequencies, likely, strict=True):
        name = f.condition.name.upper() + (f" on {f.supply_kPa:.0f} kPa" if f.condition.name == "tc5" else "")
        compared = f.model_gain, baseline.plant_gain, f.plant_gain
        for part, distances in (
            ("all points", [f.rms_dB(gains) for gains in compared]),
            ("up to 3 cut-offs", [f.rms_dB(gains, 3.0) for gains in compared]),
        ):
            line = next(line for line in page.split("\n") if line.startswith(f"| {name}, {part} |"))
            assert [float(cell) for cell in line.split("|")[2:5]] == pytest.approx(distances, abs=0.03), name
    for finding in comparison.findings:
        # The first words of each finding. The numbers of a plant that follow are in the table.
        assert " ".join(finding.split()[:12]) in " ".join(page.split())


def test_the_likely_bench_is_what_its_sensors_read() -> None:
    """While air flows through a tube, the pressure at the sensor's end is higher."""
    quiet = replace(LIKELY, noise_seed=None).with_cv(0.5)

    def reading_kPa(bench: Bench) -> float:
        return float(run(bench, lambda _: 69.0, reservoir_kPa=690.0, duration_s=0.5)["cv_reading_kPa"][-1])

    assert reading_kPa(quiet) > reading_kPa(replace(quiet, effects=replace(quiet.effects, tubing=None))) + 0.3
    noisy = run(replace(quiet, noise_seed=1), lambda _: 0.0, reservoir_kPa=690.0, duration_s=1.0)
    assert np.std(noisy["cv_reading_kPa"]) == pytest.approx(0.15, rel=0.15)


def test_figures_are_pictures(comparison: PaperComparison, tmp_path: Path) -> None:
    paths = draw(comparison.curves, tmp_path)
    assert {path.name for path in paths} == FIGURES
    for path in paths:
        content = path.read_bytes()
        assert content.startswith(PNG)
        assert 10_000 < len(content) < 200_000


@pytest.mark.usefixtures("quick")
def test_the_command_prints_one_object(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert status("paper", "--json", "--out", tmp_path / "a" / "b") == 0
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert err == ""
    assert {Path(path).name for path in found["figures"]} == FIGURES
    assert all(Path(path).is_file() for path in found["figures"])


@pytest.mark.usefixtures("quick")
def test_the_command_prints_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert status("paper") == 0
    out = capsys.readouterr().out
    for text in ("quantity", "4.1–5.7", "105.02", "What disagrees in the paper itself", "undecided"):
        assert text in out
    assert "Figure" not in out


def test_a_folder_that_cannot_be_is_one_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert status("paper", "--out", tmp_path / "file") == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert str(tmp_path / "file") in err
