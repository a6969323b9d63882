"""The diagnosis of the paper's data: what it must find, what it must leave open, and its tools."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from scipy.stats import multivariate_normal
from threadpoolctl import threadpool_limits

import flying_vines.studies.paper.diagnosis
from flying_vines.cli.main import main
from flying_vines.identification.fit import FitPoint
from flying_vines.studies.paper.compare import HIGH_RESISTANCE_RATIO
from flying_vines.studies.paper.diagnosis import PaperDiagnosis
from flying_vines.studies.paper.diagnosis.correlated import RESERVOIR, Correlated
from flying_vines.studies.paper.diagnosis.discharge import (
    ALIKE,
    LEAST_SQUARES,
    Discharges,
    analyse,
    candidate,
    causes,
    noises,
    paper_case,
    start_of,
    step_kPa,
)
from flying_vines.studies.paper.diagnosis.evidence import Linear, Noise, UnexplainedLevel, worth
from flying_vines.studies.paper.diagnosis.experiment import EXPERIMENTS, RIVALS, ExperimentProposal, propose
from flying_vines.studies.paper.diagnosis.flow_law import CHOKED, flow_laws
from flying_vines.studies.paper.diagnosis.response import FLOOR, SUSPECTS, Responses, account_for
from flying_vines.studies.paper.diagnosis.rivals import RESERVOIR_WALL
from flying_vines.studies.paper.diagnosis.show import show
from flying_vines.studies.paper.diagnosis.verdict import as_json, findings, has_heat, has_more_air

pytestmark = pytest.mark.long

FAST = (
    (),
    ("evp_restriction",),
    ("compressible_flow",),
    ("evp_restriction", "reservoir_wall"),
    ("evp_restriction", "sensor_line"),
    ("evp_restriction", "reservoir_wall", "sensor_line"),
    ("evp_restriction", "reservoir_wall", "reservoir_sensor_offset"),
    CHOKED,
    *RIVALS,
)
"""The basis of the findings."""


@pytest.fixture(scope="module")
def found() -> Discharges:
    return analyse(sets=FAST)


@pytest.fixture(scope="module")
def proposal(found: Discharges) -> ExperimentProposal:
    return propose(found, experiments=[e for e in EXPERIMENTS if e.name in ("open", "two pauses")])


@pytest.fixture(scope="module")
def responses() -> Responses:
    names = ("tube", "line_delay", "cv_heating")
    return account_for(suspects=[s for s in SUSPECTS if s.name in names], with_tube=(), again=())


@pytest.fixture(scope="module")
def diagnosis(found: Discharges, proposal: ExperimentProposal, responses: Responses) -> PaperDiagnosis:
    return PaperDiagnosis(found, flow_laws(found, HIGH_RESISTANCE_RATIO), proposal, responses)


def test_the_logger_has_steps_of_ten_bits() -> None:
    step, on_grid = step_kPa(paper_case())
    assert step == pytest.approx(1.222, abs=0.001)
    assert on_grid > 0.99


def test_more_flow_and_heat_are_named(found: Discharges) -> None:
    assert found.named.names == ("evp_restriction", "reservoir_wall")
    scale = found.named.estimates["evp_restriction"]["scale"]
    wall = found.named.estimates["reservoir_wall"]["conductance_W_per_K"]
    assert scale.estimate == pytest.approx(0.85, abs=0.03)
    assert scale.low < 0.866 < scale.high < 1.0
    assert wall.estimate == pytest.approx(1.5, abs=0.3)
    assert wall.low < 1.31 < wall.high


def test_least_squares_finds_what_a_plain_exponential_does(found: Discharges) -> None:
    (scale,) = found.of("evp_restriction").nearest.values[0]
    # The three nearest exponentials of the comparison with the paper: 90.4, 70.6, 33.1 s.
    assert scale == pytest.approx(np.mean([90.42 / 105.02, 70.62 / 80.61, 33.10 / 40.31]), abs=0.02)


def test_the_evidence_ranks_heat_with_flow_before_flow_before_nothing(found: Discharges) -> None:
    null, flow, named = found.null, found.of("evp_restriction"), found.named
    for of_null, of_flow, of_named in zip(*map(found.above, (null, flow, named)), strict=True):
        assert of_null > of_flow + 3.0
        assert of_flow > of_named + 30.0
    assert all(above > 60.0 for above in found.above(found.of("compressible_flow")))


def test_what_could_pass_for_heat_is_left_open(found: Discharges) -> None:
    possible = {c.names for c in found.open()}
    assert ("evp_restriction", "valve_settles", "sensor_line") in possible
    assert ("reservoir_leak", "reservoir_cooling") in possible
    # Heat is more likely but not certain; a larger flow is certain.
    assert all(1.0 < above < ALIKE for above in found.missed(has_heat))
    assert all(above > 10.0 for above in found.missed(has_more_air))


def test_unseen_series_are_predicted_better(found: Discharges) -> None:
    null, named = found.null.predicted_percent, found.named.predicted_percent
    assert null == pytest.approx((4.46, 4.02, 5.62), abs=0.1)
    assert named == pytest.approx((1.00, 1.43, 1.53), abs=0.1)


def test_what_no_discharge_can_tell_is_said(found: Discharges) -> None:
    pairs = {(a.first, a.second): a.correlation for a in found.alike}
    assert pairs["evp_restriction", "reservoir_volume"] == pytest.approx(1.0, abs=1e-5)
    assert np.isnan(pairs["evp_restriction", "reservoir_sensor_gain"])
    assert pairs["evp_restriction", "reservoir_leak"] == pytest.approx(-0.98, abs=0.01)
    assert abs(pairs["evp_restriction", "reservoir_cooling"]) < 0.6


def test_the_law_of_flow_hangs_on_the_ratio_of_the_settings(diagnosis: PaperDiagnosis) -> None:
    papers, other = diagnosis.flow_laws
    assert papers.ohm.rms_kPa < papers.choked.rms_kPa
    assert other.choked.rms_kPa < other.ohm.rms_kPa
    assert min(papers.choked_above) < ALIKE
    assert papers.choked.estimates["evp_restriction"]["scale"].estimate == pytest.approx(1.0, abs=0.05)


def test_the_proposed_minute_tells_apart_what_the_papers_does_not(proposal: ExperimentProposal) -> None:
    as_the_paper, best = proposal.outcomes
    assert proposal.best is best
    assert as_the_paper.worst.delta_chi2 < 0.1
    assert best.worst.delta_chi2 == pytest.approx(14.0, abs=2.0)
    heat, cold = RIVALS[0], RIVALS[2]
    apart = {(p.true, p.fitted): p.delta_chi2 for p in best.pairs}
    assert apart[heat, cold] > 25.0
    assert apart[cold, heat] > 25.0


def test_with_heat_the_pressure_rises_again_when_the_valve_shuts(proposal: ExperimentProposal) -> None:
    best = proposal.best
    shut = (best.time_s > 25.0) & (best.time_s < 35.0)
    heat, cold = (best.expected_kPa[RIVALS[i]][shut] for i in (0, 2))
    assert 10.0 < heat[-1] - heat[0] < 25.0
    assert np.ptp(cold) < 0.01


def test_sharing_the_air_tells_the_valve_from_the_volume(proposal: ExperimentProposal) -> None:
    sharing = proposal.sharing
    assert sharing.discharge_delta_chi2 < 1e-3
    assert sharing.delta_chi2_rounding > 1000.0
    # Two litres into one litre: two thirds, for any valve.
    assert sharing.ends_kPa[0] == pytest.approx(200.0 * 2.0 / 3.0, abs=1.0)


def test_the_gains_speak_for_a_tail_and_for_no_cause_of_the_catalogue(responses: Responses) -> None:
    null, floor, tube = responses.of(), responses.of(FLOOR), responses.of("tube")
    assert null.rms_dB == pytest.approx((3.33, 6.93), abs=0.1)
    assert floor.rms_dB == pytest.approx((0.84, 0.96), abs=0.1)
    assert floor.best[FLOOR] == 0.2
    assert null.minus_2_ln - floor.minus_2_ln > 70.0
    assert null.minus_2_ln - tube.minus_2_ln > 50.0
    for name in ("line_delay", "cv_heating"):
        assert null.minus_2_ln - responses.of(name).minus_2_ln < 15.0
    assert responses.above(responses.of("line_delay", FLOOR)) < ALIKE


def test_evidence_is_the_likelihood_averaged_over_parameters_and_noise() -> None:
    rng = np.random.default_rng(1)
    x = np.array([0.0, 1.0, 2.5, 4.0])
    scaled, trace, residual = rng.normal(size=4), rng.normal(size=(4, 2)), rng.normal(size=4)
    noise = Noise(0.3, (0.5, 2.0), (1.0, 5.0), (0.1,))
    model = Linear((x,), (scaled,), residual, trace, np.array([0.2, -0.4]), np.array([0.7, 1.3]))
    densities = []
    for level in noise.levels():
        whole = noise.covariance([level], x, scaled)[0] + trace @ np.diag(model.spread**2) @ trace.T
        densities.append(multivariate_normal(cov=whole).pdf(residual + trace @ model.away))
    found = worth(noise, model)
    assert found.minus_2_ln == pytest.approx(-2.0 * np.log(np.mean(densities)), rel=1e-9)
    assert found.level == noise.levels()[int(np.argmax(densities))]


def test_a_discrepancy_begins_at_nothing_unless_it_may_not() -> None:
    x, flat = np.array([0.0, 3.0, 300.0]), np.zeros(3)
    level = UnexplainedLevel(5.0, 20.0, 0.0)
    beginning = Noise(0.1, (5.0,), (20.0,), (0.0,))
    sd = np.sqrt(np.diag(beginning.covariance([level], x, flat)[0]))
    assert sd == pytest.approx([0.1, 5.0 * np.sqrt(1.0 - np.exp(-0.3)), 5.0], rel=1e-2)
    anywhere = replace(beginning, from_start=False).covariance([level], x, flat)[0]
    assert np.sqrt(np.diag(anywhere)) == pytest.approx(np.hypot(5.0, 0.1))


def test_residuals_are_independent_once_they_are_whitened() -> None:
    kind = noises(0.35)[0]
    level = UnexplainedLevel(6.0, 20.0, 0.03)
    problem = Correlated(paper_case(), kind, level)
    point = start_of(problem)
    white = problem.residuals(point)
    for index, run in enumerate(problem.case.runs):
        covariance = kind.covariance([level], run.time_s, problem.scaled[index])[0]
        left = problem.data[index][RESERVOIR] - problem.simulated(point)[index][RESERVOIR]
        assert white[index][RESERVOIR] @ white[index][RESERVOIR] == pytest.approx(
            left @ np.linalg.solve(covariance, left)
        )


def test_four_litres_are_two_with_half_the_opening() -> None:
    problem = Correlated(paper_case(), noises(0.35)[0], LEAST_SQUARES)
    simulated = problem.simulated(start_of(problem))
    for run, readings, tau_s in zip(problem.case.runs, simulated, (105.019, 80.614, 40.307), strict=True):
        exact = run.reservoir_kPa[0] * np.exp(-run.time_s / tau_s)
        assert readings[RESERVOIR] == pytest.approx(exact, rel=1e-3)


def test_a_wall_that_conducts_much_makes_the_gas_isothermal() -> None:
    problem = Correlated(paper_case(), noises(0.35)[0], LEAST_SQUARES)

    def kPa(point: FitPoint) -> float:
        return float(problem.simulated(point)[2][RESERVOIR][3])

    plain = start_of(problem)
    cold, warm = (kPa(plain.with_cause(RESERVOIR_WALL, (value,))) for value in (0.5, 1000.0))
    assert cold < kPa(plain) - 10.0
    # The rest is the cooling of the wall.
    assert warm == pytest.approx(kPa(plain), abs=5.0)


@pytest.mark.parametrize("heat", [False, True])
def test_heat_is_found_where_it_is_and_only_there(heat: bool) -> None:
    rng = np.random.default_rng(7)
    case, known, level = paper_case(), causes(), UnexplainedLevel(12.0, 320.0, 0.03)
    kind = noises(0.35)[0]
    true = Correlated(case, kind, level)
    point = start_of(true).with_cause(known["evp_restriction"], (0.85,))
    if heat:
        point = point.with_cause(known["reservoir_cooling"], (7.0,))
    runs = []
    for run, simulated, scaled in zip(case.runs, true.simulated(point), true.scaled, strict=True):
        unknown = np.linalg.cholesky(kind.covariance([level], run.time_s, scaled)[0])
        read = simulated[RESERVOIR] + unknown @ rng.normal(size=len(scaled))
        runs.append(replace(run, reservoir_kPa=np.round(read / 1.222) * 1.222))
    made = replace(case, runs=tuple(runs))
    with threadpool_limits(1):
        flow, both = (
            candidate(made, (kind,), [known[name] for name in names])
            for names in (("evp_restriction",), ("evp_restriction", "reservoir_cooling"))
        )
    gain = flow.worths[0].minus_2_ln - both.worths[0].minus_2_ln
    assert gain > 15.0 if heat else gain < -5.0
    scale = (both if heat else flow).estimates["evp_restriction"]["scale"]
    assert scale.low < 0.85 < scale.high


def test_each_finding_has_its_words_and_numbers(diagnosis: PaperDiagnosis) -> None:
    texts = findings(diagnosis)
    out = io.StringIO()
    show(diagnosis, Console(file=out, width=110))
    said = " ".join(out.getvalue().split())
    for text in texts:
        assert "nan" not in text
        assert " ".join(text.split()[:6]) in said
    assert any("evp_restriction from reservoir_volume" in text for text in texts)
    assert any("Whether the valve chokes stays open" in text for text in texts)


def test_json_and_pictures_of_the_command(
    diagnosis: PaperDiagnosis,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(flying_vines.studies.paper.diagnosis, "diagnose_paper", lambda progress: diagnosis)
    with pytest.raises(SystemExit) as done:
        main(["paper", "--diagnose", "--json", "--out", str(tmp_path)])
    assert done.value.code == 0
    printed = json.loads(capsys.readouterr().out)
    figures = [Path(path) for path in printed.pop("figures")]
    assert printed == json.loads(json.dumps(as_json(diagnosis)))
    assert printed["discharge"]["causes"] == ["evp_restriction", "reservoir_wall"]
    assert sorted(path.name for path in figures) == [
        f"paper-diagnosis-{name}.png" for name in ("discharge", "experiment", "frequency")
    ]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in figures)


def test_a_folder_that_is_a_file_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    taken = tmp_path / "taken"
    taken.write_text("")
    with pytest.raises(SystemExit) as error:
        main(["paper", "--diagnose", "--out", str(taken)])
    assert error.value.code == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
