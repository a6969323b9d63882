"""A diagnosis finds the hidden effect: it names it, measures it, and improves unseen data."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from flying_vines.identification.case import read_case
from flying_vines.identification.diagnose import diagnose
from flying_vines.identification.verdict import Verdict
from hidden_truth import draw, write
from hidden_truth.truth import Truth


def verdict_on(tier: str, seed: int, folder: Path, runs: int = 4) -> tuple[Truth, Verdict]:
    truth = draw(tier, seed)
    truth = replace(truth, plans=truth.plans[:runs])
    write(folder / "case", truth)
    return truth, diagnose(read_case(folder / "case"))


# A cause of the valves' commands, of the flows, of the gas, and one with worn numbers.
@pytest.mark.long
@pytest.mark.parametrize(("tier", "seed"), [("clear", 57), ("worn", 3), ("clear", 0), ("clear", 5)])
def test_a_single_cause_is_named_and_measured(tier: str, seed: int, tmp_path: Path) -> None:
    truth, verdict = verdict_on(tier, seed, tmp_path)
    (hidden,) = truth.hidden
    assert verdict.cause == hidden.name
    assert verdict.also == ()
    assert verdict.confidence > 0.9
    (estimate,) = verdict.parameters.values()
    assert estimate.low < estimate.estimate < estimate.high
    assert estimate.estimate == pytest.approx(hidden.value, rel=0.02)
    errors = verdict.held_out
    assert errors.nrmse_before > 1.2 * errors.nrmse_after
    assert errors.nrmse_after < 1.2 * errors.noise_floor


@pytest.mark.long
def test_two_causes_at_once_are_both_found(tmp_path: Path) -> None:
    truth, verdict = verdict_on("pair", 2, tmp_path, runs=2)
    assert {verdict.cause, *(named.cause for named in verdict.also)} == {one.name for one in truth.hidden}


@pytest.mark.long
def test_several_effects_are_found_with_their_shares(tmp_path: Path) -> None:
    truth, verdict = verdict_on("several", 7003, tmp_path)
    assert {named.cause for named in verdict.named} == {one.name for one in truth.hidden}
    assert verdict.cause == "cv_leak" and verdict.share > 0.9
    assert verdict.remainder is None
    assert verdict.held_out.nrmse_after < 1.2 * verdict.held_out.noise_floor
    hidden = {one.name: one.value for one in truth.hidden}
    for named in verdict.named:
        (estimate,) = named.parameters.values()
        assert estimate.estimate == pytest.approx(hidden[named.cause], rel=0.01)


@pytest.mark.long
def test_effects_that_explain_the_data_only_together_are_found(tmp_path: Path) -> None:
    """With fewer than four of the five causes, no set explains more than a wrong one."""
    truth, verdict = verdict_on("several", 690_004, tmp_path)
    assert {named.cause for named in verdict.named} == {one.name for one in truth.hidden}
    assert verdict.cause == "compressible_flow" and verdict.remainder is None


@pytest.mark.long
def test_an_effect_of_the_catalogue_is_measured_beside_an_unknown_one(tmp_path: Path) -> None:
    """The dead zone imitates a valve whose flow is a power of its command. The slow solenoid is one of the
    hidden effects."""
    truth, verdict = verdict_on("several_outside", 7000, tmp_path)
    assert verdict.cause == "solenoid_slow_close"
    (hidden,) = (one for one in truth.hidden if one.name == "solenoid_slow_close")
    (estimate,) = verdict.parameters.values()
    assert estimate.low <= hidden.value <= estimate.high
    assert verdict.remainder is not None and 0.0 < verdict.remainder.share < 0.1
    assert verdict.held_out.gain[0] > 0.5


@pytest.mark.long
def test_causes_that_the_data_cannot_separate_are_all_named(tmp_path: Path) -> None:
    """Without the Venturi everything is proportional to pressure: a gain of one sensor looks like the inverse
    gain of the other one."""
    truth = draw("hard", 104)
    (hidden,) = truth.hidden
    assert (truth.variant, hidden.name) == ("without_dvp", "reservoir_sensor_gain")
    write(tmp_path / "case", replace(truth, plans=truth.plans[1:3]))
    verdict = diagnose(read_case(tmp_path / "case"))
    assert {verdict.cause, *verdict.indistinguishable} >= {"reservoir_sensor_gain", "cv_sensor_gain"}
    assert verdict.also == ()
    (estimate,) = verdict.parameters.values()
    inverse = verdict.cause == "cv_sensor_gain"
    assert estimate.estimate == pytest.approx(1.0 / hidden.value if inverse else hidden.value, rel=0.01)
    assert verdict.next_experiment.startswith("Record ")


@pytest.mark.long
@pytest.mark.parametrize("runs", [2, 4])
def test_a_clean_rig_has_no_false_cause(runs: int, tmp_path: Path) -> None:
    _, verdict = verdict_on("null", 0, tmp_path, runs)
    assert verdict.cause == "none"
    assert verdict.confidence > 0.9
    assert verdict.parameters == {}


@pytest.mark.long
def test_an_unknown_effect_gets_no_name(tmp_path: Path) -> None:
    truth, verdict = verdict_on("outside", 0, tmp_path, runs=2)
    assert truth.hidden[0].name.startswith("x_")
    assert verdict.cause == "unexplained"
    assert verdict.remainder


@pytest.mark.long
@pytest.mark.parametrize(
    ("case", "within"),
    [
        # Its sensor has a lag of 2.6 ms, and the simulator's time steps are not much shorter.
        ("case_006", 0.2),
        # The nominal resistance itself is wrong by up to 2.5 %.
        ("case_008", 0.025),
    ],
)
def test_effects_of_another_simulator_are_found(case: str, within: float) -> None:
    folder = Path(__file__).parents[1] / "data" / "cases"
    answer = json.loads((folder / "answers.json").read_text(encoding="utf-8"))[case]
    verdict = diagnose(read_case(folder / case))
    assert verdict.cause == answer["effect"]
    assert verdict.also == () and verdict.indistinguishable == ()
    (estimate,) = verdict.parameters.values()
    (value,) = answer["parameters"].values()
    assert estimate.estimate == pytest.approx(value, rel=within)
