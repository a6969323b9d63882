"""The diagnosis of the paper's data finds the known cause, and leaves the others open."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest
from command_line import status
from rich.console import Console

import flying_vines.studies.paper.diagnosis
from flying_vines.identification.fit import FitProblem
from flying_vines.identification.noise import stated_noise
from flying_vines.physics.effects import cause_named
from flying_vines.studies.paper.compare import HIGH_RESISTANCE_RATIO
from flying_vines.studies.paper.diagnosis import PaperDiagnosis
from flying_vines.studies.paper.diagnosis.discharge import (
    BEST_FOR_CHOKED,
    RESERVOIR,
    SAME_AS_FLOW,
    STEP_KPA,
    VALVE_SETTLES,
    Discharges,
    analyse,
    paper_case,
)
from flying_vines.studies.paper.diagnosis.report import as_json, findings, show
from flying_vines.studies.paper.diagnosis.response import FLOOR, SUSPECTS, Responses, explain

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def found() -> Discharges:
    return analyse()


@pytest.fixture(scope="module")
def responses() -> Responses:
    names = ("tube", "line_delay", "cv_heating")
    suspects = [suspect for suspect in SUSPECTS if suspect.name in names]
    return explain(suspects=suspects, with_tube=(), again=("tube",))


@pytest.fixture(scope="module")
def diagnosis(found: Discharges, responses: Responses) -> PaperDiagnosis:
    return PaperDiagnosis(found, responses)


@pytest.fixture(scope="module")
def problem() -> FitProblem:
    case = paper_case()
    return FitProblem(case, stated_noise(case.rig))


def test_the_logger_has_steps_of_ten_bits() -> None:
    """Each reading is an angle, with one step as a full turn: all point in one direction."""
    readings_kPa = np.concatenate([run.reservoir_kPa for run in paper_case().runs])
    steps_kPa = np.linspace(0.5, 3.0, 5_001)
    alike = np.abs(np.exp(2j * np.pi * readings_kPa / steps_kPa[:, None]).mean(axis=1))
    assert len(readings_kPa) == 57
    assert steps_kPa[np.argmax(alike)] == pytest.approx(STEP_KPA, abs=0.001)
    assert alike.max() > 0.99


def test_four_litres_are_two_with_half_the_opening(problem: FitProblem) -> None:
    start = problem.start()
    start.initial[:, 0] = [data[RESERVOIR, 0] for data in problem.data]
    simulated = problem.simulated(start)
    for run, readings, tau_s in zip(problem.case.runs, simulated, (105.019, 80.614, 40.307), strict=True):
        exact = run.reservoir_kPa[0] * np.exp(-run.time_s / tau_s)
        assert readings[RESERVOIR] == pytest.approx(exact, rel=1e-3)


def test_more_flow_is_named_and_nothing_else(found: Discharges) -> None:
    verdict = found.verdict
    assert [named.cause for named in verdict.named] == ["evp_restriction"]
    scale = verdict.parameters["scale"]
    assert scale.low < 0.88 < scale.high < 1.0
    # The nearest exponentials of the three series are 90.4, 70.6 and 33.1 s.
    papers_s = {"4L_highRv": 105.02, "4L_lowRv": 80.61, "2L_lowRv": 40.31}
    for (name, alone), tau_s in zip(found.scale_alone.items(), (90.42, 70.62, 33.10), strict=True):
        assert alone == pytest.approx(tau_s / papers_s[name], abs=0.04)
    assert verdict.remainder is not None
    assert 0.1 < verdict.remainder.share < 0.25


def test_unseen_series_are_predicted_better(found: Discharges) -> None:
    errors = found.verdict.held_out
    assert errors.nrmse_before == pytest.approx(0.0397, abs=0.001)
    assert errors.nrmse_after == pytest.approx(0.0151, abs=0.001)
    assert errors.gain[0] > 0.4


def test_no_second_cause_is_sure(found: Discharges) -> None:
    second = {each.cause: each for each in found.second}
    assert {each.cause for each in found.second[:3]} == {"sensor_line", "valve_settles", "reservoir_cooling"}
    for each in found.second[:3]:
        assert each.unseen_nrmse < found.verdict.held_out.nrmse_after
    assert all(each.gain[0] < 0.0 for each in found.second)
    # Certainly worse: an offset, and choked flow.
    assert second["reservoir_sensor_offset"].gain[1] < 0.0
    assert second["compressible_flow"].gain[1] < 0.0
    (time_constant_s,) = second["reservoir_cooling"].values
    assert 2.0 < time_constant_s < 15.0


def test_no_discharge_separates_the_valve_from_the_volume(problem: FitProblem) -> None:
    flow, volume = (
        problem.fit(problem.first_fit(problem.start(), cause_named(name)).point)
        for name in ("evp_restriction", SAME_AS_FLOW)
    )
    assert flow.chi2 == pytest.approx(volume.chi2, rel=1e-6)
    assert flow.point.values[0][0] == pytest.approx(volume.point.values[0][0], rel=1e-3)


def test_a_valve_that_settles_has_its_usual_flow_in_the_end(problem: FitProblem) -> None:
    start = problem.start()
    plain, settling = (
        problem.simulated(point)[2][RESERVOIR]
        for point in (start, start.with_cause(VALVE_SETTLES, (0.3, 1.0)))
    )
    # 30 % more flow, for 1 s of a time constant of 40.3 s.
    assert settling[-1] / plain[-1] == pytest.approx(np.exp(-0.3 / 40.3), abs=2e-4)


def test_the_order_of_the_flow_laws_hangs_on_the_first_readings_and_on_the_ratio(found: Discharges) -> None:
    laws = {(law.settings_ratio, law.first_exact): law for law in found.laws}
    papers = laws[HIGH_RESISTANCE_RATIO, True]
    assert papers.ohm_kPa < papers.choked_kPa
    assert papers.choked_scale == pytest.approx(1.0, abs=0.05)
    for others in ((HIGH_RESISTANCE_RATIO, False), (BEST_FOR_CHOKED, True), (BEST_FOR_CHOKED, False)):
        assert laws[others].choked_kPa < laws[others].ohm_kPa


def test_a_discharge_with_rests_is_recommended(found: Discharges) -> None:
    assert found.recommended.runs[0].name == "discharge_evp"
    assert found.recommended.pairs[0][1] > 10.0


def test_the_gains_show_a_tail_and_no_cause_of_the_catalogue(responses: Responses) -> None:
    null, floor, tube = responses.of(), responses.of(FLOOR), responses.of("tube")
    assert null.rms_dB == pytest.approx((3.33, 6.93), abs=0.1)
    assert floor.rms_dB == floor.unseen_dB == pytest.approx((0.84, 0.96), abs=0.1)
    assert floor.best[FLOOR] == 0.2
    assert tube.unseen_dB == pytest.approx((2.67, 3.08), abs=0.1)
    for name in ("line_delay", "cv_heating"):
        assert responses.of(name).unseen > 0.8 * null.unseen
        assert responses.of(name, FLOOR).unseen > floor.unseen


def test_on_690_kPa_a_tube_predicts_better_than_on_345(responses: Responses) -> None:
    assert responses.of("tube", other=True).unseen < 0.6 * responses.of("tube").unseen
    assert responses.of(FLOOR, other=True).unseen > 1.5 * responses.of(FLOOR).unseen


def test_each_finding_has_its_text_and_numbers(diagnosis: PaperDiagnosis) -> None:
    texts = findings(diagnosis)
    out = io.StringIO()
    show(diagnosis, Console(file=out, width=110))
    said = " ".join(out.getvalue().split())
    for text in texts:
        assert "nan" not in text
        assert " ".join(text.split()[:6]) in said
    assert any("Whether there is a second cause stays open" in text for text in texts)
    assert any("Whether the valve chokes stays open" in text for text in texts)


def test_json_report_and_pictures_of_the_command(
    diagnosis: PaperDiagnosis,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(flying_vines.studies.paper.diagnosis, "diagnose_paper", lambda progress: diagnosis)
    assert status("paper", "--diagnose", "--json", "--out", tmp_path) == 0
    printed = json.loads(capsys.readouterr().out)
    figures = [Path(path) for path in printed.pop("figures")]
    assert printed == json.loads(json.dumps(as_json(diagnosis)))
    assert printed["discharge"]["cause"] == "evp_restriction"
    assert sorted(path.name for path in figures) == [
        "paper-diagnosis-discharge.png",
        "paper-diagnosis-frequency.png",
    ]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in figures)
    assert "evp_restriction" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_a_folder_that_is_a_file_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    taken = tmp_path / "taken"
    taken.write_text("")
    assert status("paper", "--diagnose", "--out", taken) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
