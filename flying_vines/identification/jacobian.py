"""Jacobian of the residuals, with the initial pressures eliminated.

The simulation of a run starts anew after each gap, with two initial pressures. They act almost linearly, and
almost only on the stretch up to the next start; only temperatures and the lag of a sensor are carried over to
the next stretch. So the residuals of each stretch, and their derivatives by all other numbers, are projected
orthogonally to the effect of its two initial pressures (variable projection, Golub & Pereyra 2003). A fit
with hundreds of starts stays a small problem. `Tangents` are the directions in which a fit can still change
its residuals.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from flying_vines.physics.arrays import Array, BoolArray

_RIDGE = 1e-12
_PARALLEL = 1e-5
"""A trace is nearly parallel to the fitted directions if less than this share of its squares is orthogonal to
them. It gains nothing: its orthogonal part is only the curvature of a finite step."""


class RunJacobian:
    """Jacobian of one run.

    Args:
        initial: (2, 2, n), derivatives of both channels by the initial pressures (reservoir, control volume).
            One array serves all starts: each start is assumed to act only on its own stretch.
        residuals: (2, n).
        common: (numbers, 2, n), derivatives by the numbers that all runs share.
        start: (starts,) rising sample numbers at which stretches start; the first is 0.
    """

    def __init__(self, initial: Array, residuals: Array, common: Array, start: NDArray[np.intp]) -> None:
        self._initial = initial
        self._common = common
        self._start = start
        self._lengths = np.diff(np.append(start, residuals.shape[1]))
        self._inverses = _inverses(np.moveaxis(self._products(initial), 2, 0))
        self.residuals = residuals

    @property
    def starts(self) -> int:
        return len(self._start)

    def where(self, used: BoolArray) -> RunJacobian:
        """The Jacobian if only these readings (2, n) count."""
        return RunJacobian(self._initial * used, self.residuals * used, self._common * used, self._start)

    def at(self, residuals: Array) -> RunJacobian:
        """The same derivatives with other residuals (2, n)."""
        other = copy(self)
        other.residuals = residuals
        other.__dict__.pop("reduced_residuals", None)
        return other

    def residuals_after(self, step: Array, initial_step: Array) -> Array:
        """(2, n) residuals after a step of the shared numbers, and of initial pressures (starts, 2)."""
        linear = self.residuals + np.tensordot(step, self._common, 1)
        after: Array = linear + self._effect(initial_step.T[None])[0]
        return after

    def _products(self, columns: Array) -> Array:
        """(columns, 2, starts): each column (2, n) times `initial`, summed over each stretch."""
        if self.starts == 1:  # A matrix product takes a third of the time.
            return (columns.reshape(len(columns), -1) @ self._initial.reshape(2, -1).T)[:, :, None]
        products = np.stack([(columns * of_pressure).sum(axis=1) for of_pressure in self._initial], axis=1)
        return np.add.reduceat(products, self._start, axis=2)

    def _effect(self, pressures: Array) -> Array:
        """(columns, 2, n): the effect of changes (columns, 2, starts) of the initial pressures."""
        if self.starts == 1:
            return np.tensordot(pressures[:, :, 0], self._initial, 1)
        each = np.repeat(pressures, self._lengths, axis=2)
        effect: Array = each[:, :1] * self._initial[0] + each[:, 1:] * self._initial[1]
        return effect

    def _shares(self, columns: Array) -> Array:
        """(columns, 2, starts): the change of the initial pressures that best fits each column (2, n)."""
        with np.errstate(invalid="ignore"):  # The simulation may have diverged.
            shares: Array = np.einsum("kjs,sji->kis", self._products(columns), self._inverses)
        return shares

    def orthogonal_part(self, columns: Array) -> Array:
        """(columns, 2 n): the part of (columns, 2, n) orthogonal to the effect of the initial pressures."""
        left: Array = columns - self._effect(self._shares(columns))
        return left.reshape(len(columns), -1)

    @cached_property
    def reduced(self) -> Array:
        """(numbers, 2 n): derivatives by the shared numbers, initial pressures eliminated."""
        if not len(self._common):
            return np.zeros((0, self.residuals.size))
        return self.orthogonal_part(self._common)

    @cached_property
    def reduced_residuals(self) -> Array:
        """(2 n,): residuals, initial pressures eliminated."""
        left: Array = self.orthogonal_part(self.residuals[None])[0]
        return left

    def initial_step(self, step: Array) -> Array:
        """(starts, 2): the best step of the initial pressures for this step of the shared numbers."""
        there = self.residuals + np.tensordot(step, self._common, 1) if len(step) else self.residuals
        best: Array = -self._shares(there[None])[0].T
        return best

    def initial_correction(self, residuals: Array) -> tuple[Array, float]:
        """(starts, 2): the best step of the initial pressures for these residuals, and its gain in χ²."""
        left = self.orthogonal_part(residuals[None])
        return -self._shares(residuals[None])[0].T, float(np.vdot(residuals, residuals) - np.vdot(left, left))


def _inverses(square: Array) -> Array:
    """Inverses of (starts, 2, 2) products of the derivatives; a pressure without a reading is not moved."""
    scale = np.sqrt(np.diagonal(square, axis1=1, axis2=2))
    scale = np.where(scale > 0.0, scale, 1.0)
    outer = scale[:, :, None] * scale[:, None, :]
    scaled = square / outer + _RIDGE * np.eye(2)
    scaled[:, range(2), range(2)] += np.diagonal(scaled, axis1=1, axis2=2) < 0.5
    inverses: Array = np.linalg.inv(scaled) / outer
    return inverses


class Jacobian:
    """Jacobian of all runs."""

    def __init__(self, runs: Sequence[RunJacobian]) -> None:
        self.runs = runs

    @cached_property
    def reduced(self) -> Array:
        """(numbers, readings): see `RunJacobian.reduced`."""
        return np.concatenate([run.reduced for run in self.runs], axis=1)

    @cached_property
    def square(self) -> Array:
        """(numbers, numbers): JᵀJ of the reduced derivatives."""
        return self.reduced @ self.reduced.T

    @cached_property
    def reduced_residuals(self) -> Array:
        """(readings,): see `RunJacobian.reduced_residuals`."""
        return np.concatenate([run.reduced_residuals for run in self.runs])

    def at(self, residuals: Sequence[Array]) -> Jacobian:
        """The same derivatives with other residuals, (2, n) a run."""
        other = Jacobian([run.at(r) for run, r in zip(self.runs, residuals, strict=True)])
        other.__dict__.update(reduced=self.reduced, square=self.square)
        return other

    def where(self, used: Sequence[BoolArray]) -> Jacobian:
        """The Jacobian if only these readings count, (2, n) a run."""
        return Jacobian([run.where(mask) for run, mask in zip(self.runs, used, strict=True)])

    def linear(self, step: Array) -> Array:
        """(readings,): residuals after a step by these derivatives, initial pressures eliminated."""
        after: Array = self.reduced_residuals + step[: len(self.reduced)] @ self.reduced
        return after

    def nonlinearity(self, step: Array, residuals: Sequence[Array]) -> float:
        """Sum of squares of the difference between the residuals after a step and `linear`."""
        return float(np.sum((self.orthogonal_part(residuals) - self.linear(step)) ** 2))

    def curved(self, step: Array, probe: Sequence[Array], share: float) -> Jacobian:
        """The same derivatives; half of the second derivative along a step is added to the residuals.

        Args:
            step: of the shared numbers, then of the initial pressures in the order of `FitPoint.initial`.
            probe: residuals after this share of the step.
        """
        common = len(self.reduced)
        pressures, after = step[common:].reshape(-1, 2), []
        for run, there in zip(self.runs, probe, strict=True):
            linear = run.residuals_after(share * step[:common], share * pressures[: run.starts])
            after.append(run.residuals + (there - linear) / share**2)
            pressures = pressures[run.starts :]
        return self.at(after)

    def step_change(self, straight: Array, curved: Array) -> float:
        """The difference of two steps of the shared numbers, as a share of the first.

        Each number counts by its effect on the residuals.
        """
        scale = np.linalg.norm(self.reduced, axis=1)
        one, other = (scale * step[: len(scale)] for step in (straight, curved))
        length = float(np.linalg.norm(one))
        return float(np.linalg.norm(other - one)) / length if length > 0.0 else 0.0

    def initial_step(self, step: Array) -> Array:
        """The step of all initial pressures, flattened in the order of `FitPoint.initial`."""
        return np.concatenate([run.initial_step(step).ravel() for run in self.runs])

    def initial_correction(self, residuals: Sequence[Array]) -> tuple[Array, float]:
        """The best step of all initial pressures for these residuals, flattened, and its gain in χ²."""
        found = [run.initial_correction(r) for run, r in zip(self.runs, residuals, strict=True)]
        return np.concatenate([step.ravel() for step, _ in found]), sum(gain for _, gain in found)

    def orthogonal_part(self, trace: Sequence[Array]) -> Array:
        """The part of a trace, (2, n) a run, orthogonal to the effect of the initial pressures; flattened."""
        return np.concatenate(
            [run.orthogonal_part(t[None])[0] for run, t in zip(self.runs, trace, strict=True)]
        )


class Tangents:
    """The directions in which a fit can change its residuals, and the residuals' part orthogonal to them.

    Args:
        free: (numbers,) False where a number is on its bound.
    """

    def __init__(self, jacobian: Jacobian, residuals: Sequence[Array], free: BoolArray) -> None:
        self._jacobian = jacobian
        directions = jacobian.reduced[free].T
        scale = np.linalg.norm(directions, axis=0)
        self._basis, _ = np.linalg.qr(directions / np.where(scale > 0.0, scale, 1.0))
        self._residual = self.orthogonal_part(residuals)

    def gain(self, trace: Sequence[Array], backwards: bool) -> float:
        """Reduction of χ² if the fit could also add a multiple of this trace to the residuals.

        Args:
            trace: for each run (2, n), a change of the residuals.
            backwards: True if the multiple may be negative.
        """
        own = self.orthogonal_part(trace)
        length = float(own @ own)
        whole = sum(float(np.vdot(t, t)) for t in trace)
        slope = float(own @ self._residual)
        if length <= _PARALLEL * whole or (slope > 0.0 and not backwards):
            return 0.0
        return slope**2 / length

    def orthogonal_part(self, trace: Sequence[Array]) -> Array:
        """The part of a trace, (2, n) for each run, orthogonal to all fitted directions; flattened."""
        left = self._jacobian.orthogonal_part(trace)
        orthogonal: Array = left - self._basis @ (self._basis.T @ left)
        return orthogonal
