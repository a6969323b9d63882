"""A fit with eliminated initial pressures gives the same step as a fit of everything."""

from __future__ import annotations

import numpy as np
import pytest

from flying_vines.identification.jacobian import RunJacobian
from flying_vines.physics.arrays import Array

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
