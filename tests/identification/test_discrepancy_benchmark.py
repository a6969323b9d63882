"""Scores of the discrepancy benchmark, and its tables from a results file."""

from __future__ import annotations

from math import inf
from pathlib import Path
from typing import Any

import pytest
from discrepancy import main
from discrepancy_report import neutral_values
from discrepancy_scores import (
    Judgement,
    Outcome,
    ResultsError,
    append,
    as_outcome,
    begun,
    brier,
    counts,
    false_names,
    holds,
    judge,
    large,
    measured,
    off,
    over_noise,
    read_outcomes,
    reliability,
    share_errors,
    wilson,
)

GAIN = {"gain": 1.05}
OFFSET = {"offset_kPa": 2.0}
LEAK = {"flow_resistance_kPa_s_per_SL": 1000.0}


def row(effect: str, cause: str, tier: str = "clear", seed: int = 0, **said: Any) -> dict[str, Any]:
    """A row as a worker makes it. `true` has the hidden cause's parameters, `truly_also` a further hidden
    effect."""
    also = said.pop("truly_also", [])
    truth = {"effect": effect, "tier": tier, "variant": "", "seed": seed, "gap": 5000.0}
    truth |= {"parameters": said.pop("true", {}), "also": also, "nominal": {"Vr": 2.0}}
    truth |= {"share": said.pop("true_share", None)}
    verdict = {"cause": cause, "confidence": 0.97, "ranking": []} | said
    return {"engine": "0123abcd", "truth": truth, "said": verdict, "cpu_s": 4.0}


def outcome(*args: Any, **kwargs: Any) -> Outcome:
    return as_outcome(row(*args, **kwargs))


def judged(*args: Any, **kwargs: Any) -> Judgement:
    one = outcome(*args, **kwargs)
    assert one.said is not None
    return judge(one.truth, one.said)


@pytest.mark.parametrize(
    ("count", "of", "low", "high"),
    # The first three are calculated by hand with the formula of Brown, Cai & DasGupta; the last has no data.
    [(10, 10, 0.722467, 1.0), (0, 20, 0.0, 0.161125), (81, 263, 0.255289, 0.366216), (0, 0, 0.0, 1.0)],
)
def test_wilsons_interval(count: int, of: int, low: float, high: float) -> None:
    assert wilson(count, of) == pytest.approx((low, high), abs=1e-5)


def test_a_cause_is_right_or_among_its_like_or_left_open_or_wrong() -> None:
    assert judged("cv_leak", "cv_leak") is Judgement.RIGHT
    assert judged("cv_leak", "evp_lag", indistinguishable=["cv_leak"]) is Judgement.ALIKE
    assert judged("cv_leak", "evp_lag", indistinguishable=["dead_volume"]) is Judgement.WRONG
    assert judged("cv_leak", "unexplained") is Judgement.OPEN
    assert judged("cv_leak", "none") is Judgement.WRONG
    assert judged("cv_leak", "none", confidence=0.6) is Judgement.OPEN
    # A cause that is named after another one with a larger share is wrong.
    assert judged("cv_leak", "evp_lag", also=[{"cause": "cv_leak"}]) is Judgement.WRONG


def test_a_clean_rig_hides_none_and_what_is_outside_is_unexplained() -> None:
    assert judged("none", "none", tier="null") is Judgement.RIGHT
    assert judged("none", "unexplained", tier="null") is Judgement.WRONG
    assert judged("none", "cv_leak", tier="null") is Judgement.WRONG
    assert judged("x_seam", "unexplained", tier="outside") is Judgement.RIGHT
    assert judged("x_seam", "none", tier="outside", confidence=0.3) is Judgement.WRONG
    assert judged("x_seam", "cv_leak", tier="outside") is Judgement.WRONG


def test_of_two_causes_both_have_to_be_named_in_any_order() -> None:
    two: dict[str, Any] = {"tier": "pair", "truly_also": [{"effect": "evp_lag", "parameters": {}}]}
    assert judged("cv_leak", "evp_lag", also=[{"cause": "cv_leak"}], **two) is Judgement.RIGHT
    assert judged("cv_leak", "cv_leak", **two) is Judgement.WRONG
    assert judged("cv_leak", "cv_leak", indistinguishable=["evp_lag"], **two) is Judgement.ALIKE


THREE: dict[str, Any] = {
    "tier": "several",
    "true_share": 0.6,
    "truly_also": [
        {"effect": "evp_lag", "parameters": {}, "share": 0.2},
        {"effect": "dead_volume", "parameters": {}, "share": 0.03},
    ],
}


def test_of_several_effects_the_largest_is_first_and_the_large_ones_are_listed() -> None:
    assert judged("cv_leak", "cv_leak", **THREE) is Judgement.RIGHT
    assert judged("cv_leak", "evp_lag", also=[{"cause": "cv_leak"}], **THREE) is Judgement.WRONG
    assert judged("cv_leak", "viscous_leak", indistinguishable=["cv_leak"], **THREE) is Judgement.ALIKE
    assert judged("cv_leak", "unexplained", **THREE) is Judgement.OPEN
    one = outcome("cv_leak", "cv_leak", share=0.7, also=[{"cause": "line_delay", "share": 0.1}], **THREE)
    assert one.said is not None
    assert large(one.truth) == ["cv_leak", "evp_lag"]
    assert share_errors(one.truth, one.said) == pytest.approx([0.1])
    assert false_names(one.truth, one.said) == ["line_delay"]


def test_beside_an_effect_outside_the_catalogue_the_largest_of_it_is_to_be_first() -> None:
    beside = {
        "tier": "several_outside",
        "true_share": 0.7,
        "truly_also": [{"effect": "evp_lag", "parameters": {}, "share": 0.2}],
    }
    assert judged("x_seam", "evp_lag", **beside) is Judgement.RIGHT
    assert judged("x_seam", "cv_leak", **beside) is Judgement.WRONG
    one = outcome("x_seam", "unexplained", **beside)
    assert one.truth.partly_outside and not one.truth.outside
    assert one.said is not None and holds(one.truth, one.said)
    assert large(one.truth) == ["evp_lag"]


def test_only_a_short_run_may_be_left_open() -> None:
    assert counts(outcome("cv_leak", "unexplained", tier="short"))
    assert not counts(outcome("cv_leak", "unexplained", tier="clear"))
    assert not counts(outcome("cv_leak", "evp_lag", tier="short"))
    failed = row("cv_leak", "cv_leak", tier="short") | {"said": None, "error": "ValueError: no"}
    assert not counts(as_outcome(failed))


def test_false_names_are_those_that_are_not_there() -> None:
    one = outcome("cv_leak", "cv_leak", also=[{"cause": "evp_lag"}])
    assert one.said is not None
    assert false_names(one.truth, one.said) == ["evp_lag"]


@pytest.mark.parametrize(
    ("cause", "true", "estimate", "error"),
    [
        ("cv_sensor_gain", GAIN, 1.06, 0.2),
        ("cv_sensor_offset", OFFSET, 1.9, 0.05),
        ("cv_leak", LEAK, 1100.0, 0.1),
        ("compressible_flow", {"critical_pressure_ratio": 0.4}, 0.3, 0.25),
    ],
)
def test_errors_are_shares_of_the_distance_from_neutral(
    cause: str, true: dict[str, float], estimate: float, error: float
) -> None:
    (name, value), *_ = true.items()
    interval = {"estimate": estimate, "low": 0.0, "high": value}
    one = outcome(cause, cause, true=true, parameters={name: interval})
    assert one.said is not None
    (found,) = measured(one.truth, one.said)
    assert off(found, neutral_values()) == pytest.approx(error)
    assert found.held
    # A parameter without effect has no distance.
    assert off(found, {(cause, name): value}) == inf


def test_nothing_is_measured_of_a_cause_that_is_not_there() -> None:
    wrong = {"gain": {"estimate": 1.0, "low": 0.9, "high": 1.1}}
    one = outcome("reservoir_sensor_gain", "cv_sensor_gain", true=GAIN, parameters=wrong)
    assert one.said is not None
    assert list(measured(one.truth, one.said)) == []


def test_confidence_is_about_the_cause_and_what_looks_like_it() -> None:
    def held(*args: Any, **kwargs: Any) -> bool:
        one = outcome(*args, **kwargs)
        assert one.said is not None
        return holds(one.truth, one.said)

    assert held("cv_leak", "evp_lag", indistinguishable=["cv_leak"])
    assert not held("cv_leak", "evp_lag")
    assert not held("cv_leak", "unexplained")
    assert held("none", "none") and not held("cv_leak", "none")
    assert held("x_seam", "unexplained") and not held("x_seam", "none")
    assert held("a", "b", truly_also=[{"effect": "b", "parameters": {}}])


def test_reliability_and_brier() -> None:
    stated = [(0.97, True), (0.96, False), (0.3, False), (0.5, True), (1.0, True)]
    found = reliability(stated)
    assert [(one.low, one.high, one.held, one.of) for one in found] == [
        (0.0, 0.5, 1, 2),
        (0.95, 0.98, 1, 2),
        (0.98, 1.0, 1, 1),
    ]
    assert [one.stated for one in found] == pytest.approx([0.4, 0.965, 1.0])
    assert brier(stated) == pytest.approx((0.03**2 + 0.96**2 + 0.3**2 + 0.5**2) / 5)


def test_an_error_on_unseen_data_is_reported_in_units_of_noise() -> None:
    errors = {"nrmse_before": 0.2, "nrmse_after": 0.011, "noise_floor": 0.01}
    one = outcome("cv_leak", "cv_leak", held_out=errors)
    assert one.said is not None and over_noise(one.said) == pytest.approx(1.1)


def test_a_file_that_was_cut_off_is_gone_on_with(tmp_path: Path) -> None:
    file = tmp_path / "results.jsonl"
    assert begun(file) == []
    append(file, row("cv_leak", "cv_leak", seed=1))
    whole = file.read_text(encoding="utf-8")
    file.write_text(whole + whole[:40], encoding="utf-8")
    assert len(read_outcomes(file)) == 1
    (known,) = begun(file)
    assert known.key == ("clear", 1)
    append(file, row("cv_leak", "cv_leak", seed=2, confidence=float("nan")))
    assert [one.truth.seed for one in read_outcomes(file)] == [1, 2]


@pytest.mark.parametrize("text", ["notes", "{}\n", '[1]\n{"engine": 3}\n', '{"engine": "0123abcd"}\n'])
def test_another_file_is_refused_and_left_alone(text: str, tmp_path: Path) -> None:
    file = tmp_path / "notes.txt"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ResultsError, match=r"notes\.txt:1: is not an outcome"):
        begun(file)
    assert file.read_text(encoding="utf-8") == text


def test_the_tables_come_from_a_file_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "results.jsonl"
    offset = {"estimate": 2.1, "low": 2.05, "high": 2.15}
    errors = {"nrmse_before": 0.2, "nrmse_after": 0.013, "noise_floor": 0.01}
    rows = [
        row("cv_leak", "cv_leak", seed=1),
        row("cv_sensor_offset", "cv_sensor_offset", seed=2, true=OFFSET, parameters={"offset_kPa": offset}),
        row("evp_lag", "line_delay", seed=3, confidence=0.55, held_out=errors, also=[{"cause": "cv_leak"}]),
        row("none", "none", tier="null", seed=1),
        row("x_seam", "cv_leak", tier="outside", seed=1),
        row(
            "cv_leak",
            "cv_leak",
            seed=9,
            confidence=None,
            held_out=errors,
            also=[{"cause": "line_delay"}],
            **THREE,
        ),
        row("cv_leak", "none", tier="hard", seed=1) | {"said": None, "error": "ValueError: broken"},
    ]
    for one in rows:
        append(file, one)
    assert main(["--report", str(file)]) == 0
    report = capsys.readouterr().out
    lines = [" ".join(line.replace("|", " ").split()) for line in report.splitlines()]
    assert "clear 2/3 21% … 94% 98% 2 0 0 1 1/1 0/1 0/1 4 s" in lines
    assert "evp_lag 1 1 cv_leak + line_delay" in lines
    of = "several 1 1/1 (21% … 100%) 1/2 (9% … 91%) 1/2 (9% … 91%) 1/1 (21% … 100%) – – 4 s"
    assert of in lines
    assert "a cause 50% to 80% 1 55.0% 0.0% 0% … 79% 0.3113" in lines
    assert "a cause was named with more than 50%: 1/1 (21% … 100%); with `none`: 0/1" in " ".join(
        report.split()
    )
    assert "Rigs without a hidden effect for which a cause was named: 0/1 (0% … 79%)" in lines
    assert "failed: hard 1: ValueError: broken" in lines


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--report", "nowhere.jsonl"], "nowhere.jsonl: cannot be read: No such file"),
        (["--tiers", "clear,odd"], "there is no tier 'odd'"),
        (["--cases", "0"], "give 1 or more"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert says in capsys.readouterr().err.splitlines()[-1]
