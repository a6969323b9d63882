"""The discrepancy benchmark's scores and tables, and the measured rigs beside independent fits."""

from __future__ import annotations

from math import inf
from pathlib import Path
from typing import Any

import measured
import numpy as np
import pytest
from discrepancy import main
from discrepancy_report import neutral_values
from discrepancy_scores import (
    Judgement,
    ResultsError,
    append,
    as_outcome,
    begun,
    counts,
    false_names,
    holds,
    judge,
    large,
    off,
    read_outcomes,
    share_errors,
)
from discrepancy_scores import measured as parameters_of
from measured_fits import ALPHA_KPA, AMBIENT_KPA, Fitted, Readings, leak

RIGHT, ALIKE, OPEN, WRONG = Judgement.RIGHT, Judgement.ALIKE, Judgement.OPEN, Judgement.WRONG
OFFSET = {"offset_kPa": 2.0}
TWO: dict[str, Any] = {"tier": "pair", "truly_also": [{"effect": "evp_lag", "parameters": {}}]}
THREE: dict[str, Any] = {
    "tier": "several",
    "true_share": 0.6,
    "truly_also": [
        {"effect": "evp_lag", "parameters": {}, "share": 0.2},
        {"effect": "dead_volume", "parameters": {}, "share": 0.03},
    ],
}
BESIDE: dict[str, Any] = {**THREE, "tier": "several_outside", "true_share": 0.7}
ALSO_LEAK = [{"cause": "cv_leak"}]


def row(effect: str, cause: str, tier: str = "clear", seed: int = 0, **said: Any) -> dict[str, Any]:
    """A row as a worker makes it. `true` has the hidden cause's parameters, `truly_also` a further hidden
    effect."""
    also = said.pop("truly_also", [])
    truth = {"effect": effect, "tier": tier, "variant": "", "seed": seed, "gap": 5000.0}
    truth |= {"parameters": said.pop("true", {}), "also": also, "nominal": {"Vr": 2.0}}
    truth |= {"share": said.pop("true_share", None)}
    verdict = {"cause": cause, "confidence": 0.97, "ranking": []} | said
    return {"engine": "0123abcd", "truth": truth, "said": verdict, "cpu_s": 4.0}


def truth_and_said(*args: Any, **kwargs: Any) -> tuple[Any, Any]:
    one = as_outcome(row(*args, **kwargs))
    assert one.said is not None
    return one.truth, one.said


@pytest.mark.parametrize(
    ("effect", "cause", "more", "expected"),
    [
        ("cv_leak", "cv_leak", {}, RIGHT),
        ("cv_leak", "evp_lag", {"indistinguishable": ["cv_leak"]}, ALIKE),
        ("cv_leak", "evp_lag", {"indistinguishable": ["dead_volume"]}, WRONG),
        ("cv_leak", "unexplained", {}, OPEN),
        ("cv_leak", "none", {}, WRONG),
        ("cv_leak", "none", {"confidence": 0.6}, OPEN),
        # A cause that is named after another one with a larger share is wrong.
        ("cv_leak", "evp_lag", {"also": ALSO_LEAK}, WRONG),
        ("none", "none", {"tier": "null"}, RIGHT),
        ("none", "unexplained", {"tier": "null"}, WRONG),
        ("none", "cv_leak", {"tier": "null"}, WRONG),
        ("x_seam", "unexplained", {"tier": "outside"}, RIGHT),
        ("x_seam", "none", {"tier": "outside", "confidence": 0.3}, WRONG),
        ("x_seam", "cv_leak", {"tier": "outside"}, WRONG),
        # Of two causes both have to be named, in any order.
        ("cv_leak", "evp_lag", TWO | {"also": ALSO_LEAK}, RIGHT),
        ("cv_leak", "cv_leak", TWO, WRONG),
        ("cv_leak", "cv_leak", TWO | {"indistinguishable": ["evp_lag"]}, ALIKE),
        # Of several effects the largest is named first.
        ("cv_leak", "cv_leak", THREE, RIGHT),
        ("cv_leak", "evp_lag", THREE | {"also": ALSO_LEAK}, WRONG),
        ("cv_leak", "viscous_leak", THREE | {"indistinguishable": ["cv_leak"]}, ALIKE),
        ("cv_leak", "unexplained", THREE, OPEN),
        ("x_seam", "evp_lag", BESIDE, RIGHT),
        ("x_seam", "cv_leak", BESIDE, WRONG),
    ],
)
def test_judgement(effect: str, cause: str, more: dict[str, Any], expected: Judgement) -> None:
    assert judge(*truth_and_said(effect, cause, **more)) is expected


def test_shares_false_names_and_what_counts() -> None:
    also = [{"cause": "line_delay", "share": 0.1}]
    truth, said = truth_and_said("cv_leak", "cv_leak", share=0.7, also=also, **THREE)
    assert large(truth) == ["cv_leak", "evp_lag"]
    assert share_errors(truth, said) == pytest.approx([0.1])
    assert false_names(truth, said) == ["line_delay"]
    truth, said = truth_and_said("x_seam", "unexplained", **BESIDE)
    assert truth.partly_outside and not truth.outside and holds(truth, said) and large(truth) == ["evp_lag"]
    # Only a short run may be left open.
    for cause, tier, expected in (("unexplained", "short", True), ("unexplained", "clear", False)):
        assert counts(as_outcome(row("cv_leak", cause, tier=tier))) == expected
    assert not counts(as_outcome(row("cv_leak", "cv_leak", tier="short") | {"said": None, "error": "no"}))


@pytest.mark.parametrize(
    ("cause", "true", "estimate", "error"),
    [
        ("cv_sensor_gain", {"gain": 1.05}, 1.06, 0.2),
        ("cv_sensor_offset", OFFSET, 1.9, 0.05),
        ("compressible_flow", {"critical_pressure_ratio": 0.4}, 0.3, 0.25),
    ],
)
def test_errors_are_shares_of_the_distance_from_neutral(
    cause: str, true: dict[str, float], estimate: float, error: float
) -> None:
    ((name, value),) = true.items()
    estimated = {name: {"estimate": estimate, "low": 0.0, "high": value}}
    (found,) = parameters_of(*truth_and_said(cause, cause, true=true, parameters=estimated))
    assert off(found, neutral_values()) == pytest.approx(error) and found.held
    # A parameter without effect has no distance, and a cause that is not there has no parameters.
    assert off(found, {(cause, name): value}) == inf
    assert list(parameters_of(*truth_and_said("evp_lag", cause, true=true, parameters=estimated))) == []


def test_a_results_file_is_continued_and_another_file_left_alone(tmp_path: Path) -> None:
    file = tmp_path / "results.jsonl"
    assert begun(file) == []
    append(file, row("cv_leak", "cv_leak", seed=1))
    whole = file.read_text(encoding="utf-8")
    file.write_text(whole + whole[:40], encoding="utf-8")
    (known,) = begun(file)
    assert known.key == ("clear", 1)
    append(file, row("cv_leak", "cv_leak", seed=2, confidence=float("nan")))
    assert [one.truth.seed for one in read_outcomes(file)] == [1, 2]
    for text in ("notes", "{}\n", '[1]\n{"engine": 3}\n', '{"engine": "0123abcd"}\n'):
        file.write_text(text, encoding="utf-8")
        with pytest.raises(ResultsError, match=r"results\.jsonl:1: is not an outcome"):
            begun(file)
        assert file.read_text(encoding="utf-8") == text


def test_the_tables_come_from_a_file_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "results.jsonl"
    offset = {"estimate": 2.1, "low": 2.05, "high": 2.15}
    errors = {"nrmse_before": 0.2, "nrmse_after": 0.013, "noise_floor": 0.01}
    several = {"confidence": None, "held_out": errors, "also": [{"cause": "line_delay"}], **THREE}
    for one in (
        row("cv_leak", "cv_leak", seed=1),
        row("cv_sensor_offset", "cv_sensor_offset", seed=2, true=OFFSET, parameters={"offset_kPa": offset}),
        row("evp_lag", "line_delay", seed=3, confidence=0.55, held_out=errors, also=ALSO_LEAK),
        row("none", "none", tier="null", seed=1),
        row("x_seam", "cv_leak", tier="outside", seed=1),
        row("cv_leak", "cv_leak", seed=9, **several),
        row("cv_leak", "none", tier="hard", seed=1) | {"said": None, "error": "ValueError: broken"},
    ):
        append(file, one)
    assert main(["--report", str(file)]) == 0
    report = capsys.readouterr().out
    lines = [" ".join(line.replace("|", " ").split()) for line in report.splitlines()]
    assert "clear 2/3 21% … 94% 98% 2 0 0 1 1/1 0/1 0/1 4 s" in lines
    assert "evp_lag 1 1 cv_leak + line_delay" in lines
    of = "several 1 1/1 (21% … 100%) 1/2 (9% … 91%) 1/2 (9% … 91%) 1/1 (21% … 100%) – – 4 s"
    assert of in lines
    assert "a cause 50% to 80% 1 55.0% 0.0% 0% … 79% 0.3113" in lines
    named = "a cause was named with more than 50%: 1/1 (21% … 100%); with `none`: 0/1"
    assert named in " ".join(report.split())
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


def test_an_independent_fit_finds_the_law_of_a_leak_and_its_number() -> None:
    time_s, volume_L = np.arange(0.0, 60.0, 0.5), 0.1
    # dP/dt = -k P (P + 2 ambient), separated and integrated.
    k = ALPHA_KPA / (volume_L * 1e7)
    growth = (1.0 + 2.0 * AMBIENT_KPA / 700.0) * np.exp(2.0 * AMBIENT_KPA * k * time_s)
    for law, parameter, number, kPa in (
        ("ohm", "flow_resistance_kPa_s_per_SL", 2e4, 700.0 * np.exp(-ALPHA_KPA * time_s / (volume_L * 2e4))),
        ("viscous", "conductance_constant_kPa2_s_per_SL", 1e7, 2.0 * AMBIENT_KPA / (growth - 1.0)),
    ):
        noise_kPa = 0.05 * np.random.default_rng(1).standard_normal(time_s.size)
        best, *_ = leak(Readings(time_s, kPa + noise_kPa, np.zeros(time_s.size)), volume_L)
        assert best.law == law and best.parameters[parameter] == pytest.approx(number, rel=0.002)


def interval(estimate: float, low: float, high: float) -> dict[str, float]:
    return {"estimate": estimate, "low": low, "high": high}


def test_measured_parameters_beside_independent_ones() -> None:
    said: dict[str, Any] = {
        "cause": "compressible_flow",
        "share": 0.8,
        "parameters": {"critical_pressure_ratio": interval(0.4, 0.35, 0.45)},
        "also": [
            {"cause": "ambient_drop", "parameters": {"rate_kPa_per_s": interval(0.3, 0.2, 0.4)}},
            {"cause": "reservoir_cooling", "parameters": {"time_constant_s": interval(5.0, 6.0, 7.0)}},
        ],
    }
    impossible = ["ambient_drop rate_kPa_per_s 0.3", "reservoir_cooling time_constant_s 5"]
    assert measured.impossible(said) == impossible
    fits = [Fitted("choked, cooling, cold flow", {"critical_pressure_ratio": 0.2}, 1.0)]
    fits.append(Fitted("choked, cooling", {"critical_pressure_ratio": 0.43}, 1.1))
    first, second, *_ = measured.compared(said, fits)
    assert first == "compressible_flow 0.4 (0.35 … 0.45), independent 0.43"
    assert second == "ambient_drop 0.3 (0.2 … 0.4)"
    tried = {"cv_leak": {"flow_resistance_kPa_s_per_SL": interval(300.0, 290.0, 310.0)}}
    said = {"cause": "unexplained", "also": [], "ranking": [{"cause": "cv_leak", "parameters": tried}]}
    assert list(measured.compared(said, [])) == ["cv_leak 300 (290 … 310)"]


def test_every_recording_is_imported_by_its_answers(tmp_path: Path) -> None:
    names = []
    for name, files in measured.cases(measured.GROUPS):
        assert len(measured.imported(files, tmp_path / name).runs) == len(files)
        names.append(name)
    assert {"plenum_discharge", "pump_and_chamber", "pump_and_chamber/sweep_kp_15"} <= set(names)


@pytest.mark.long
def test_three_discharges_give_the_ratio_and_the_wall_of_an_independent_fit() -> None:
    """No single cause improves this fit enough. The valve opens between two readings, and readings are
    rounded."""
    *_, (name, files) = measured.cases(["plenum_discharge"])
    looked = measured.look(name, files)
    parameters = {one["cause"]: one["parameters"] for one in measured.named(looked.said)}
    assert looked.said["cause"] == "compressible_flow"
    ratio = parameters["compressible_flow"]["critical_pressure_ratio"]
    independent = next(fit for fit in looked.fits if fit.law == "choked, cooling").parameters
    assert ratio["low"] < independent["critical_pressure_ratio"] < ratio["high"]
    assert ratio["estimate"] == pytest.approx(independent["critical_pressure_ratio"], rel=0.15)
    assert {"reservoir_cooling", "reservoir_sensor_offset"} <= set(parameters)
    assert looked.said["held_out"]["nrmse_after"] < looked.said["held_out"]["nrmse_before"] / 3.0
