"""A fit with eliminated initial pressures gives the same step as a fit of everything."""

from __future__ import annotations

import numpy as np
import pytest

from flying_vines.identification.jacobian import Jacobian, RunJacobian, Tangents
from flying_vines.physics.arrays import Array
from flying_vines.physics.cause import Parameter

START = np.array([0, 3, 40, 41, 60])
SAMPLES, NUMBERS = 90, 3


def whole(initial: Array) -> Array:
    """(2 × stretches, 2 n): each initial pressure's derivatives, 0 outside its stretch."""
    rows = []
    for begin, end in zip(START, (*START[1:], SAMPLES), strict=True):
        for pressure in initial:
            row = np.zeros((2, SAMPLES))
            row[:, begin:end] = pressure[:, begin:end]
            rows.append(row.ravel())
    return np.array(rows)


@pytest.mark.parametrize("unread", [False, True])
def test_the_rest_moves_as_in_a_fit_of_everything_at_once(unread: bool) -> None:
    random = np.random.default_rng(1)
    initial = random.standard_normal((2, 2, SAMPLES))
    common = random.standard_normal((NUMBERS, 2, SAMPLES))
    residuals = random.standard_normal((2, SAMPLES))
    if unread:
        # The longest stretch has no reading of the reservoir.
        initial[0, :, 3:40] = 0.0
    jacobian = RunJacobian(initial, residuals, common, START)
    everything = np.concatenate((common.reshape(NUMBERS, -1), whole(initial))).T
    best, *_ = np.linalg.lstsq(everything, -residuals.ravel(), rcond=None)
    step: Array = np.asarray(
        np.linalg.solve(jacobian.reduced @ jacobian.reduced.T, -jacobian.reduced @ jacobian.reduced_residuals)
    )
    assert step == pytest.approx(best[:NUMBERS], rel=1e-8)
    assert jacobian.initial_step(step).ravel() == pytest.approx(best[NUMBERS:], rel=1e-6, abs=1e-9)


def test_effects_of_initial_pressures_are_eliminated() -> None:
    random = np.random.default_rng(2)
    initial = random.standard_normal((2, 2, SAMPLES))
    jacobian = RunJacobian(initial, np.zeros((2, SAMPLES)), np.zeros((0, 2, SAMPLES)), START)
    one = whole(initial)[5].reshape(1, 2, SAMPLES)
    assert np.abs(jacobian.orthogonal_part(one)).max() < 1e-9 * np.abs(one).max()
    assert jacobian.reduced.shape == (0, 2 * SAMPLES)


def test_the_curvature_along_a_step_is_half_of_the_second_derivative() -> None:
    """Two runs with residuals that are quadratic in the shared numbers, and linear in the pressures."""
    random = np.random.default_rng(3)
    step = random.standard_normal(NUMBERS + 2 * 2 * len(START))
    shared, pressures = step[:NUMBERS], step[NUMBERS:].reshape(2, len(START), 2)
    runs, bends, probe = [], [], []
    for own in pressures:
        initial, residuals = random.standard_normal((2, 2, SAMPLES)), random.standard_normal((2, SAMPLES))
        common, second = random.standard_normal((NUMBERS, 2, SAMPLES)), random.standard_normal((2, SAMPLES))
        runs.append(RunJacobian(initial, residuals, common, START))
        linear = np.tensordot(shared, common, 1) + (own.ravel() @ whole(initial)).reshape(2, SAMPLES)
        bends.append(second)
        probe.append(residuals + 0.1 * linear + 0.1**2 * second)
    curved = Jacobian(runs).curved(step, probe, share=0.1)
    for run, there, second in zip(runs, curved.runs, bends, strict=True):
        assert there.residuals == pytest.approx(run.residuals + second, rel=1e-9)
    assert curved.reduced == pytest.approx(Jacobian(runs).reduced)
    assert not np.allclose(curved.reduced_residuals, Jacobian(runs).reduced_residuals)


def test_a_one_sided_effect_predicts_no_gain_backwards() -> None:
    random = np.random.default_rng(4)
    residuals = random.standard_normal((2, SAMPLES))
    run = RunJacobian(
        random.standard_normal((2, 2, SAMPLES)),
        residuals,
        random.standard_normal((NUMBERS, 2, SAMPLES)),
        START,
    )
    tangents = Tangents(Jacobian([run]), [residuals], np.array([True, True, False]))
    towards, away = [-0.1 * residuals], [0.1 * residuals]
    assert tangents.gain(towards, backwards=False) == pytest.approx(tangents.gain(away, backwards=True))
    assert tangents.gain(towards, backwards=False) > 0.5 * np.vdot(residuals, residuals)
    assert tangents.gain(away, backwards=False) == 0.0


def test_a_parameter_is_two_sided_if_neutral_is_inside_its_range() -> None:
    gain = Parameter("gain", low=0.8, high=1.25, seeds=(1.0,), neutral=1.0, source="")
    volume = Parameter("volume_L", low=0.0, high=1.0, seeds=(0.1,), neutral=0.0, source="")
    resistance = Parameter("resistance", low=3.0, high=1e4, seeds=(30.0,), neutral=None, source="")
    assert [p.two_sided for p in (gain, volume, resistance)] == [True, False, False]


def test_other_residuals_leave_the_derivatives_as_they_are() -> None:
    random = np.random.default_rng(4)
    parts = [random.standard_normal((k, 2, SAMPLES)) for k in (2, NUMBERS)]
    first, other = random.standard_normal((2, 2, SAMPLES))
    anew = Jacobian([RunJacobian(parts[0], other, parts[1], START)])
    again = Jacobian([RunJacobian(parts[0], first, parts[1], START)]).at([other])
    assert again.reduced == pytest.approx(anew.reduced)
    assert again.square == pytest.approx(anew.reduced @ anew.reduced.T)
    assert again.reduced_residuals == pytest.approx(anew.reduced_residuals)


def test_a_linear_model_has_no_nonlinearity_and_its_residuals_are_foreseen() -> None:
    random = np.random.default_rng(5)
    initial, common = random.standard_normal((2, 2, SAMPLES)), random.standard_normal((NUMBERS, 2, SAMPLES))
    residuals, step = random.standard_normal((2, SAMPLES)), random.standard_normal(NUMBERS)
    jacobian = Jacobian([RunJacobian(initial, residuals, common, START)])
    after = residuals + np.tensordot(step, common, 1)
    assert jacobian.orthogonal_part([after]) == pytest.approx(jacobian.linear(step))
    assert jacobian.nonlinearity(step, [after]) == pytest.approx(0.0, abs=1e-20)
    off = random.standard_normal((2, SAMPLES))
    square = jacobian.orthogonal_part([off]) @ jacobian.orthogonal_part([off])
    assert jacobian.nonlinearity(step, [after + off]) == pytest.approx(square)
