"""A tier has its defined properties, and a hidden effect is visible in its data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import least_squares

from hidden_truth import draw, make
from hidden_truth.draw import FAINT, LEADS, SHOWS, TIERS, _candidate
from hidden_truth.effects import CAUSES, EFFECTS, OUTSIDE, Hidden
from hidden_truth.examples import example
from hidden_truth.gap import chi_square, gap
from hidden_truth.kernel import Array
from hidden_truth.recording import WITHOUT, Flags, misfit, replay
from hidden_truth.rig import NUMBERS, WORN, physics
from hidden_truth.truth import Truth

pytestmark = pytest.mark.long


@cache
def drawn(tier: str) -> tuple[Truth, ...]:
    return tuple(draw(tier, seed) for seed in range(1 if tier == "pair" or "several" in tier else 2))


def readings(truth: Truth) -> int:
    return sum(int(np.isfinite(run.read[run.kept]).sum()) for run in make(truth))


@pytest.mark.parametrize("tier", TIERS)
def test_the_truth_leaves_only_noise_and_hidden_effects_are_visible(tier: str) -> None:
    for truth in drawn(tier):
        runs = make(truth)
        n = readings(truth)
        assert truth.hidden == () or truth.gap >= FAINT[0]
        information = truth.independent_share
        if not truth.hidden:
            assert -80.0 / information < truth.gap < 30.0 / information
        if "x_ceiling" not in [one.name for one in truth.hidden]:
            rounding = truth.converter_step**2 / 12.0
            spread = 5.0 * np.sqrt(2.0 / (n * information))
            assert chi_square(truth, runs) / n == pytest.approx(1.0 + rounding, abs=spread)


@pytest.mark.parametrize("tier", ["faint", "outside", "holes"])
def test_equal_seeds_give_equal_cases_and_other_seeds_give_others(tier: str) -> None:
    first, second, *_ = drawn(tier)
    again = draw(tier, 0)
    assert (again.hidden, again.rig, again.assumed, again.gap) == (
        first.hidden,
        first.rig,
        first.assumed,
        first.gap,
    )
    for one, other in zip(make(first), make(again), strict=True):
        assert np.array_equal(one.read, other.read, equal_nan=True)
        assert np.array_equal(one.kept, other.kept)
    assert not np.array_equal(make(first)[0].read, make(second)[0].read, equal_nan=True)


@pytest.mark.parametrize("tier", ["clear", "subtle", "short", "holes", "worn", "faint"])
def test_one_cause_of_the_table_is_hidden_or_none_in_the_worn_tier(tier: str) -> None:
    for truth in drawn(tier):
        assert len(truth.hidden) == 1 or (tier == "worn" and not truth.hidden)
        assert {one.name for one in truth.hidden} <= set(CAUSES)
        if tier == "faint":
            assert FAINT[0] <= truth.gap <= FAINT[1]
        elif truth.hidden:
            assert truth.gap >= SHOWS


def test_the_hidden_effects_of_the_other_tiers() -> None:
    assert all(truth.hidden == () for truth in drawn("null"))
    assert all(truth.hidden[0].name in OUTSIDE and len(truth.hidden) == 1 for truth in drawn("outside"))
    assert all(truth.hidden[0].name != truth.hidden[1].name for truth in drawn("pair"))
    assert all(len(truth.hidden) <= 1 for truth in drawn("rounded"))
    assert all((truth.converter_step > 0.0) != (truth.correlation_s > 0.0) for truth in drawn("rounded"))


def test_both_effects_of_a_pair_are_visible_and_the_first_explains_more() -> None:
    truth = drawn("pair")[0]
    runs = make(truth)
    assert truth.gap == gap(truth, runs)
    first, second = truth.hidden
    assert SHOWS <= gap(truth, runs, known=(first,)) <= gap(truth, runs, known=(second,))
    assert abs(gap(truth, runs, known=truth.hidden)) < 60.0


def test_nominal_numbers_are_wrong_only_in_worn_rigs_and_within_the_stated_tolerance() -> None:
    for tier in TIERS:
        for truth in drawn(tier):
            off = [getattr(truth.assumed, name) != getattr(truth.rig, name) for name in NUMBERS]
            if tier == "worn" or truth.variant == "worn":
                assert truth.tolerance_percent == 2.5
                assert off == [name in WORN for name in NUMBERS]
                for name in WORN:
                    ratio = getattr(truth.assumed, name) / getattr(truth.rig, name)
                    assert abs(ratio - 1.0) <= 0.02501
            else:
                assert truth.assumed == truth.rig


def test_runs_are_of_the_public_kinds() -> None:
    for truth in drawn("clear"):
        assert [plan.name for plan in truth.plans] == ["steps", "prbs", "bends", "hold"]
        assert all(plan.time_s.size == 2250 and plan.time_s[-1] == 44.98 for plan in truth.plans)
        assert all(430.0 <= plan.reservoir_kPa <= 690.0 for plan in truth.plans)
        runs = {run.name: run for run in make(truth)}
        assert set(np.unique(runs["prbs"].inputs[:, 0])) <= {0.0, 0.15, 0.3, 0.5, 0.75, 1.0}
        assert np.all(runs["steps"].inputs[:, 0].round(4) == runs["steps"].inputs[:, 0])
        assert set(np.unique(runs["bends"].command_kPa)) == {0.0, 20.7}
        assert set(np.unique(runs["steps"].command_kPa)) <= {0.0, 7.0, 14.0, 21.0, 35.0, 50.0, 69.0}
        assert np.all(runs["hold"].inputs[45:, 0] == 0.0)
    assert all(len(t.plans) == 1 and t.plans[0].time_s.size == 1000 for t in drawn("short"))


@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect_is_visible_in_the_data(name: str) -> None:
    truth = example(name)
    found = gap(truth, make(truth))
    print(f"{name} {truth.hidden[0].value:.4g}: gap {found:.0f}")
    assert found > 100.0  # without an effect it is below 30


@pytest.mark.parametrize("variant", ["", "cells", "lost", "held", "uneven", "without_cv_pressure"])
def test_without_the_effect_the_gap_is_only_noise(variant: str) -> None:
    truth = replace(example("cv_leak", variant), hidden=())
    assert -80.0 < gap(truth, make(truth)) < 30.0


@pytest.mark.parametrize("name", ["cv_leak", "evp_lag", "reservoir_cooling", "cv_sensor_offset"])
def test_a_weaker_effect_has_a_smaller_gap(name: str) -> None:
    truth = example(name)
    gaps = []
    for share in (1.0, 1.0 / 3.0, 0.003):
        weaker = replace(truth, hidden=(truth.hidden[0].weaker(share),))
        gaps.append(gap(weaker, make(weaker)))
    assert gaps[0] > 2.0 * gaps[1] > 600.0
    assert gaps[2] < gaps[1] / 1000.0 + 30.0


def test_the_gap_is_that_of_an_exact_fit() -> None:
    """scipy's least squares over the same numbers, with new derivatives at every step."""
    truth = drawn("faint")[0]
    runs = make(truth)
    n = len(NUMBERS)
    limit = truth.tolerance_percent / 100.0

    def residuals(x: Array) -> Array:
        moved = {name: getattr(truth.assumed, name) * (1.0 + x[i]) for i, name in enumerate(NUMBERS)}
        p = physics(replace(truth.assumed, **moved))
        models = []
        for i, run in enumerate(runs):
            start = (run.start_kPa[0] + float(x[n + 2 * i]), run.start_kPa[1] + float(x[n + 2 * i + 1]))
            models.append(misfit(truth, run, replay(p, run.inputs, run.time_s, start)))
        return np.concatenate(models)

    bound = np.array([limit] * n + [20.0] * (2 * len(runs)))
    fit = least_squares(
        residuals,
        np.zeros(bound.size),
        bounds=(-bound, bound),
        x_scale=bound / 10.0,
        diff_step=1e-4,
        max_nfev=6,
    )
    exact = 2.0 * fit.cost - chi_square(truth, runs)
    print(f"{truth.hidden}: {truth.gap:.1f} by its own, {exact:.1f} by least squares")
    assert truth.gap == pytest.approx(exact, abs=3.0)


def longest(gone: Flags) -> int:
    return max(len(part) for part in "".join("x" if g else "." for g in gone).split("."))


@pytest.mark.parametrize("variant", ["cells", "held", "lost"])
def test_holes(variant: str) -> None:
    truth = example("cv_leak", variant)
    for run in make(truth):
        empty = np.isnan(run.read)
        if variant == "cells":
            assert run.kept.all()
            assert 0.04 < empty.mean() < 0.06 + 100 / run.time_s.size
            assert 100 <= longest(empty[:, 0] & empty[:, 1]) < 110
            continue
        assert run.kept[0]
        assert not empty.any()
        assert 100 <= longest(~run.kept) < 110
        repeated = run.inputs[run.kept][np.cumsum(run.kept) - 1]
        if variant == "held" or run.name == "hold":
            assert np.array_equal(repeated, run.inputs)
        else:
            assert not np.array_equal(repeated, run.inputs)


@pytest.mark.parametrize(
    ("variant", "check"),
    [
        ("uneven", lambda t: np.unique(np.diff(t.plans[0].time_s)).size > 10),
        ("discharge", lambda t: t.rig.cv_L is None and [run.name for run in make(t)] == ["discharge"]),
        ("without_cv_pressure", lambda t: all(np.isnan(run.read[:, 0]).all() for run in make(t))),
        ("without_reservoir_pressure", lambda t: all(np.isnan(run.read[:, 1]).all() for run in make(t))),
        ("without_dvp", lambda t: all(np.all(run.inputs[:, 1] == 0.0) for run in make(t))),
        ("without_command", lambda t: all("command_kPa" in run.missing for run in make(t))),
    ],
)
def test_the_variants_of_hard_cases(variant: str, check: Callable[[Truth], bool]) -> None:
    assert check(example("reservoir_leak", variant))


def test_the_hard_tier_has_all_its_variants() -> None:
    truths = [_candidate("hard", seed, (0, seed, 0), np.random.default_rng(seed)) for seed in range(60)]
    assert {truth.variant for truth in truths} == {"uneven", "discharge", "noise", *WITHOUT}
    for truth in truths:
        if truth.variant == "discharge":
            assert all(one.effect.seen_without_cv for one in truth.hidden)
        assert (truth.stated != truth.noise) == (truth.variant == "noise")
    assert 5 <= sum(not truth.hidden for truth in truths) <= 25


def test_an_unknown_tier_is_refused() -> None:
    with pytest.raises(ValueError, match="no tier 'murky': there are clear, subtle"):
        draw("murky", 0)


def test_effects_that_cannot_be_weakened() -> None:
    with pytest.raises(ValueError, match="cannot be weaker"):
        Hidden("compressible_flow", 0.3).weaker(0.5)


def test_each_of_several_effects_has_a_share_and_the_first_has_the_largest() -> None:
    for tier in ("several", "several_outside"):
        for truth in drawn(tier):
            names = [one.name for one in truth.hidden]
            inside = [name for name in names if name in CAUSES]
            low, high = (3, 6) if tier == "several" else (2, 4)
            assert low <= len(inside) <= high
            assert len(names) - len(inside) == (tier == "several_outside")
            assert len({_element(name) for name in names}) == len(names)
            assert list(truth.shares) == sorted(truth.shares, reverse=True)
            assert truth.shares[0] >= LEADS * truth.shares[1]
            assert truth.shares[-1] * truth.gap >= SHOWS
            others = truth.hidden[1:]
            back = gap(truth, make(truth), known=others)
            assert truth.shares[0] == pytest.approx(back / truth.gap, rel=0.02)


def _element(name: str) -> str:
    """Effects that look alike are not hidden together: a leak has one law, and one of two sensors has a wrong
    gain."""
    if name.endswith("_gain"):
        return "gain"
    return name.removeprefix("cv_").replace("viscous_", "")


def test_a_converter_rounds_the_readings_and_keeps_their_noise() -> None:
    plain = example("cv_leak")
    step = replace(plain, variant="rounded", converter_step=3.0)
    for run in make(step):
        for column, std_kPa in enumerate((plain.noise.cv_kPa, plain.noise.reservoir_kPa)):
            steps = run.read[:, column] / (3.0 * std_kPa)
            assert steps == pytest.approx(steps.round(), abs=0.005 / std_kPa)
            off = (run.read[:, column] - run.clean[:, column]) / std_kPa
            assert np.abs(off).max() < 1.5 + 5.0


def test_correlated_noise_is_as_large_as_white_noise_and_has_its_correlation_time() -> None:
    for correlation_s in (0.05, 0.2):
        truth = replace(example("cv_leak"), variant="correlated", correlation_s=correlation_s)
        noise = [(run.read - run.clean) / (0.15, 1.2) for run in make(truth)]
        assert np.std(np.concatenate(noise)) == pytest.approx(1.0, abs=0.1)
        now, later = (np.concatenate([one[part] for one in noise]) for part in (slice(-5), slice(5, None)))
        expected = np.exp(-0.1 / correlation_s)
        assert np.corrcoef(now.ravel(), later.ravel())[0, 1] == pytest.approx(expected, abs=0.1)


def test_half_of_the_leaks_are_viscous() -> None:
    names = [
        one.name
        for seed in range(300)
        for one in _candidate("pair", seed, (0, seed, 0), np.random.default_rng(seed)).hidden
        if "leak" in one.name
    ]
    viscous = sum("viscous" in name for name in names)
    assert len(names) > 30
    assert 0.25 < viscous / len(names) < 0.75
