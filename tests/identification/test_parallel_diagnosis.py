"""Many cases: processes and a cluster give equal verdicts, and an error in one case stops no other."""

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

from flying_vines.files.extras import install_command
from flying_vines.identification import parallel_diagnosis
from flying_vines.identification.case import Case, read_case
from flying_vines.identification.diagnose import diagnose
from flying_vines.identification.parallel_diagnosis import CaseOutcome, ClusterError, diagnose_all
from flying_vines.identification.recording import CaseError
from flying_vines.identification.show import show_all
from flying_vines.identification.simulate import THREADS
from flying_vines.identification.verdict import Verdict

RIG = "[reservoir]\nvolume_L = 2.0\n[sensors]\nreservoir_noise_std_kPa = 1.2\n"


def discharge(folder: Path, scale: float) -> Path:
    """A reservoir that discharges to atmosphere; `scale` multiplies the nominal time constant."""
    folder.mkdir(parents=True)
    (folder / "rig.toml").write_text(RIG)
    time_s = np.arange(0.0, 120.0, 0.5)
    noise_kPa = np.random.default_rng(1).normal(0.0, 1.2, len(time_s))
    kPa = 650.0 * np.exp(-time_s * 101.325 / (2042.0 * 2.0 * scale)) + noise_kPa
    rows = "".join(f"{t:.2f},{p:.2f}\n" for t, p in zip(time_s, kPa, strict=True))
    (folder / "run.csv").write_text("time_s,reservoir_pressure_kPa\n" + rows)
    return folder


@pytest.fixture(scope="module")
def cases(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A good rig, a folder without a run, and a rig with a bad valve."""
    parent = tmp_path_factory.mktemp("cases")
    empty = parent / "empty"
    empty.mkdir()
    return [discharge(parent / "good", 1.0), empty, discharge(parent / "bad", 1.2)]


@pytest.fixture(scope="module")
def expected(cases: list[Path]) -> dict[Path, Verdict]:
    """The verdicts of a simple loop, without the empty case."""
    verdicts = {path: diagnose(read_case(path)) for path in (cases[0], cases[2])}
    assert [verdict.cause == "none" for verdict in verdicts.values()] == [True, False]
    return verdicts


def same_verdicts(
    outcomes: dict[Path, CaseOutcome], cases: list[Path], expected: dict[Path, Verdict]
) -> bool:
    error = outcomes[cases[1]]
    assert isinstance(error, CaseError) and str(cases[1]) in str(error)
    verdicts = {path: said for path, said in outcomes.items() if isinstance(said, Verdict)}
    return {path: json.dumps(verdict.as_json()) for path, verdict in verdicts.items()} == {
        path: json.dumps(verdict.as_json()) for path, verdict in expected.items()
    }


@pytest.mark.long
def test_processes_give_the_verdicts_of_a_loop(cases: list[Path], expected: dict[Path, Verdict]) -> None:
    assert same_verdicts(dict(diagnose_all(cases, workers=2)), cases, expected)


@pytest.mark.long
def test_a_cluster_gives_the_verdicts_of_a_loop(cases: list[Path], expected: dict[Path, Verdict]) -> None:
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, protocol="tcp", dashboard_address="127.0.0.1:0"
    ) as cluster:
        assert same_verdicts(dict(diagnose_all(cases, scheduler=cluster.scheduler_address)), cases, expected)


@pytest.mark.parametrize("address", ("nowhere", "127.0.0.1:1"))
def test_an_address_without_a_scheduler_is_an_error(
    cases: list[Path], address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(parallel_diagnosis, "ANSWER_S", 0.2)
    with pytest.raises(ClusterError, match=f"^{address}: .*scheduler"):
        list(diagnose_all(cases, scheduler=address))


def test_without_dask_a_scheduler_is_refused(
    cases: list[Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    line = command_line.refused(capsys, "diagnose", *cases, "--scheduler", "tcp://127.0.0.1:8786")
    assert "needs distributed" in line and install_command("cluster") in line


def replace_diagnose(monkeypatch: pytest.MonkeyPatch, diagnose: Callable[[Case], Verdict]) -> None:
    monkeypatch.setattr(parallel_diagnosis, "diagnose", diagnose)


@pytest.mark.long
def test_an_exception_costs_only_its_own_verdict(
    cases: list[Path], expected: dict[Path, Verdict], monkeypatch: pytest.MonkeyPatch
) -> None:
    def faulty(case: Case) -> Verdict:
        if case.path == cases[0]:
            raise ZeroDivisionError("division by zero")
        return expected[case.path]

    replace_diagnose(monkeypatch, faulty)
    outcomes = dict(diagnose_all(cases, workers=1))
    assert (
        str(outcomes[cases[0]]) == f"{cases[0]}: could not be diagnosed: ZeroDivisionError: division by zero"
    )
    assert outcomes[cases[2]] is expected[cases[2]]


class BreakingPool(Executor):
    """A pool that loses a process at its first job."""

    def __init__(self) -> None:
        self.jobs = 0

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.jobs += 1
        if self.jobs > 1:
            raise BrokenProcessPool("not usable anymore")
        future: Future[Any] = Future()
        future.set_exception(BrokenProcessPool("terminated abruptly"))
        return future


def test_a_dead_process_gives_an_error_for_each_lost_case(cases: list[Path]) -> None:
    outcomes = dict(
        parallel_diagnosis._as_completed(BreakingPool(), [(path, path) for path in cases], 2, 1, None)
    )
    said = [str(outcomes[path]) for path in cases]
    assert "terminated abruptly" in said[0] and "not usable anymore" in said[1]
    assert all(
        text.startswith(f"{path}: the process gave no verdict")
        for path, text in zip(cases, said, strict=True)
    )


def test_a_diagnosis_uses_its_share_of_the_cores(
    cases: list[Path], expected: dict[Path, Verdict], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []

    def watched(case: Case) -> Verdict:
        seen.append(THREADS.get())
        return expected[case.path]

    replace_diagnose(monkeypatch, watched)
    parallel_diagnosis._outcome((cases[0], cases[0]), 3, None)
    assert (seen, THREADS.get()) == ([3], 0)


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    return command_line.run(capsys, "diagnose", *arguments)


@pytest.fixture
def known_verdicts(expected: dict[Path, Verdict], monkeypatch: pytest.MonkeyPatch) -> None:
    """Replaces diagnoses by the known verdicts, in this process."""
    monkeypatch.setattr(parallel_diagnosis, "cores", lambda: 1)
    replace_diagnose(monkeypatch, lambda case: expected[case.path])


@pytest.mark.usefixtures("known_verdicts")
def test_the_output_is_a_line_for_each_case_and_the_totals(
    cases: list[Path], expected: dict[Path, Verdict], capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, _ = run(capsys, *map(str, cases))
    assert status == 2
    good, empty, bad, *table = out.splitlines()
    cause = expected[cases[2]].cause
    assert good.startswith(f"{cases[0]}  none  ")
    assert empty.startswith(f"no verdict  {cases[1]}: ")
    assert bad.startswith(f"{cases[2]}  {cause}  ")
    counts = {words[0]: words[-1] for line in table if (words := line.split())}
    assert counts["none"] == counts[cause] == "1" and counts["3"] == "cases"


@pytest.mark.usefixtures("known_verdicts")
def test_json_prints_one_object_per_line(
    cases: list[Path], expected: dict[Path, Verdict], capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, _ = run(capsys, *map(str, cases), "--json")
    objects = [json.loads(line) for line in out.splitlines()]
    assert status == 2 and [o["case"] for o in objects] == [str(path) for path in cases]
    assert [o.get("cause") for o in objects] == ["none", None, expected[cases[2]].cause]
    assert str(cases[1]) in objects[1]["error"]
    status, *_ = run(capsys, str(cases[0]), str(cases[2]), "--json")
    assert status == 0


@pytest.mark.usefixtures("known_verdicts")
def test_on_a_terminal_there_are_lines_and_a_progress_bar(cases: list[Path]) -> None:
    screen = StringIO()
    console = Console(file=screen, force_terminal=True, width=200)
    assert not show_all(diagnose_all(cases), len(cases), False, console)
    assert "/3" in screen.getvalue() and str(cases[2]) in screen.getvalue()


def test_options_for_one_case_are_refused_with_several(
    cases: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    two = command_line.refused(capsys, "diagnose", cases[0], cases[2], "--write-rig", "x.toml")
    assert "--write-rig" in two
    assert run(capsys)[::2] == (2, "flying-vines: diagnose needs a CASE, or a flight log: --from-log LOG\n")
