"""Nonlinear least squares with numpy alone: a calibration has to run without scipy."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from flying_vines.physics.arrays import Array

MAX_STEPS = 20
MAX_DAMPING = 1e4
MIN_GAIN = 1e-2
"""A step that lowers χ² by less ends the fit."""


def least_squares(
    residual: Callable[[Array], Array], start: Array, low: Array, high: Array, difference: Array
) -> tuple[Array, Array]:
    """The minimum of |residual|² within bounds near `start`, and the residual's Jacobian there.

    Method of Levenberg and Marquardt; `difference`: step of each parameter for its derivative.
    """
    place, damping = start, 1e-2
    residuals = residual(place)

    def jacobian() -> Array:
        return np.array([(residual(place + d) - residuals) / d.sum() for d in np.diag(difference)]).T

    derivatives = jacobian()
    for _ in range(MAX_STEPS):
        normal = derivatives.T @ derivatives
        move = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), derivatives.T @ residuals)
        tried = np.clip(place - move, low, high)
        tried_residuals = residual(tried)
        gained = float(residuals @ residuals - tried_residuals @ tried_residuals)
        if gained > 0.0:
            place, residuals, damping = tried, tried_residuals, 0.1 * damping
            derivatives = jacobian()
        else:
            damping *= 10.0
        if damping > MAX_DAMPING or 0.0 < gained < MIN_GAIN:
            break
    return place, derivatives
