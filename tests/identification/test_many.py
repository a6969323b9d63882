"""Many cases: the same verdicts in any process, and no verdict is lost because of another case."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from io import StringIO
from pathlib import Path
from typing import Any

import command_line
import numpy as np
import pytest
from rich.console import Console

from flying_vines.identification import many
from flying_vines.identification.case import Case, read_case
from flying_vines.identification.cores import THREADS
from flying_vines.identification.diagnose import diagnose
from flying_vines.identification.many import CaseOutcome, ClusterError, diagnose_all
from flying_vines.identification.recording import CaseError
from flying_vines.identification.show_many import show_all
from flying_vines.identification.verdict import Verdict

RIG = "[reservoir]\nvolume_L = 2.0\n[sensors]\nreservoir_noise_std_kPa = 1.2\n"


def discharge(folder: Path, scale: float) -> Path:
    """A reservoir that discharges to atmosphere, slower than nominal by this factor."""
    folder.mkdir(parents=True)
    (folder / "rig.toml").write_text(RIG)
    time_s = np.arange(0.0, 120.0, 0.5)
    noise_kPa = np.random.default_rng(1).normal(0.0, 1.2, len(time_s))
    kPa = 650.0 * np.exp(-time_s * 101.325 / (2042.0 * 2.0 * scale)) + noise_kPa
    rows = "".join(f"{t:.2f},{p:.2f}\n" for t, p in zip(time_s, kPa, strict=True))
    (folder / "run.csv").write_text("time_s,reservoir_pressure_kPa\n" + rows)
    return folder


@pytest.fixture(scope="module")
def season(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A good rig, one with a bad valve, and between them a folder without a run."""
    parent = tmp_path_factory.mktemp("season")
    empty = parent / "empty"
    empty.mkdir()
    return [discharge(parent / "good", 1.0), empty, discharge(parent / "bad", 1.2)]


@pytest.fixture(scope="module")
def alone(season: list[Path]) -> dict[Path, Verdict]:
    """The verdicts of a simple loop."""
    verdicts = {path: diagnose(read_case(path)) for path in (season[0], season[2])}
    assert [verdict.cause == "none" for verdict in verdicts.values()] == [True, False]
    return verdicts


def same(outcomes: dict[Path, CaseOutcome], season: list[Path], alone: dict[Path, Verdict]) -> bool:
    error = outcomes[season[1]]
    assert isinstance(error, CaseError) and str(season[1]) in str(error)
    verdicts = {path: said for path, said in outcomes.items() if isinstance(said, Verdict)}
    return {path: json.dumps(verdict.as_json()) for path, verdict in verdicts.items()} == {
        path: json.dumps(verdict.as_json()) for path, verdict in alone.items()
    }


@pytest.mark.long
def test_processes_find_what_a_loop_finds(season: list[Path], alone: dict[Path, Verdict]) -> None:
    assert same(dict(diagnose_all(season, workers=2)), season, alone)


@pytest.mark.long
def test_a_cluster_finds_what_a_loop_finds(season: list[Path], alone: dict[Path, Verdict]) -> None:
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, protocol="tcp", dashboard_address="127.0.0.1:0"
    ) as cluster:
        assert same(dict(diagnose_all(season, scheduler=cluster.scheduler_address)), season, alone)


@pytest.mark.parametrize("address", ("nowhere", "127.0.0.1:1"))
def test_a_cluster_that_is_none_is_one_sentence(
    season: list[Path], address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(many, "ANSWER_S", 0.2)
    with pytest.raises(ClusterError, match=f"^{address}: .*scheduler"):
        list(diagnose_all(season, scheduler=address))


def test_without_dask_a_scheduler_is_refused(
    season: list[Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    status, out, err = run(capsys, *map(str, season), "--scheduler", "tcp://127.0.0.1:8786")
    assert (status, out) == (2, "") and err.count("\n") == 1
    assert "needs distributed" in err and "pip install 'flying-vines[cluster]'" in err


def instead(monkeypatch: pytest.MonkeyPatch, diagnose: Callable[[Case], Verdict]) -> None:
    monkeypatch.setattr(many, "diagnose", diagnose)


def test_a_fault_of_ours_costs_one_verdict(
    season: list[Path], alone: dict[Path, Verdict], monkeypatch: pytest.MonkeyPatch
) -> None:
    def faulty(case: Case) -> Verdict:
        if case.path == season[0]:
            raise ZeroDivisionError("division by zero")
        return alone[case.path]

    instead(monkeypatch, faulty)
    outcomes = dict(diagnose_all(season, workers=1))
    assert (
        str(outcomes[season[0]])
        == f"{season[0]}: could not be diagnosed: ZeroDivisionError: division by zero"
    )
    assert outcomes[season[2]] is alone[season[2]]


class Mortal(Executor):
    """A pool that loses a process with its first job."""

    def __init__(self) -> None:
        self.jobs = 0

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.jobs += 1
        if self.jobs > 1:
            raise BrokenProcessPool("not usable anymore")
        future: Future[Any] = Future()
        future.set_exception(BrokenProcessPool("terminated abruptly"))
        return future


def test_a_process_that_dies_is_told_for_every_case_that_it_costs(season: list[Path]) -> None:
    outcomes = dict(many._as_they_come(Mortal(), [(path, path) for path in season], 2, 1, None))
    said = [str(outcomes[path]) for path in season]
    assert "terminated abruptly" in said[0] and "not usable anymore" in said[1]
    assert all(
        text.startswith(f"{path}: the process gave no verdict")
        for path, text in zip(season, said, strict=True)
    )


def test_each_search_keeps_to_its_share_of_the_cores(
    season: list[Path], alone: dict[Path, Verdict], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []

    def watched(case: Case) -> Verdict:
        seen.append(THREADS.get())
        return alone[case.path]

    instead(monkeypatch, watched)
    many._outcome((season[0], season[0]), 3, None)
    assert (seen, THREADS.get()) == ([3], 0)


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    return command_line.run(capsys, "diagnose", *arguments)


@pytest.fixture
def canned(alone: dict[Path, Verdict], monkeypatch: pytest.MonkeyPatch) -> None:
    """Diagnoses in this process, with known verdicts."""
    monkeypatch.setattr(many, "cores", lambda: 1)
    instead(monkeypatch, lambda case: alone[case.path])


@pytest.mark.usefixtures("canned")
def test_a_line_a_case_and_the_sum_of_all(
    season: list[Path], alone: dict[Path, Verdict], capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, _ = run(capsys, *map(str, season))
    assert status == 2
    good, empty, bad, *table = out.splitlines()
    cause = alone[season[2]].cause
    assert good.startswith(f"{season[0]}  none  ")
    assert empty.startswith(f"no verdict  {season[1]}: ")
    assert bad.startswith(f"{season[2]}  {cause}  ")
    counts = {words[0]: words[-1] for line in table if (words := line.split())}
    assert counts["none"] == counts[cause] == "1" and counts["3"] == "cases"


@pytest.mark.usefixtures("canned")
def test_json_is_an_object_a_line(
    season: list[Path], alone: dict[Path, Verdict], capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, _ = run(capsys, *map(str, season), "--json")
    objects = [json.loads(line) for line in out.splitlines()]
    assert status == 2 and [o["case"] for o in objects] == [str(path) for path in season]
    assert [o.get("cause") for o in objects] == ["none", None, alone[season[2]].cause]
    assert str(season[1]) in objects[1]["error"]
    status, *_ = run(capsys, str(season[0]), str(season[2]), "--json")
    assert status == 0


@pytest.mark.usefixtures("canned")
def test_on_a_terminal_lines_stand_above_the_bar(season: list[Path]) -> None:
    screen = StringIO()
    console = Console(file=screen, force_terminal=True, width=200)
    assert not show_all(diagnose_all(season), len(season), False, console)
    assert "/3" in screen.getvalue() and str(season[2]) in screen.getvalue()


def test_what_is_for_one_case_is_refused_for_several(
    season: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, err = run(capsys, str(season[0]), str(season[2]), "--write-rig", "x.toml")
    assert (status, out) == (2, "") and err.count("\n") == 1 and "--write-rig" in err
    assert run(capsys)[::2] == (2, "flying-vines: diagnose needs a CASE, or a flight log: --from-log LOG\n")
