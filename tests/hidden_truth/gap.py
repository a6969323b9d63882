"""How much worse the best fit of a smaller model is than the truth, in chi-square.

The fit of the baseline may change every number of the rig within its tolerance, and the initial pressures of
every run freely. It uses at most four rounds of Gauss and Newton's method, with exact bounds in the linear
problem. Derivatives are at the nominal rig; with known effects they are new in each round. The result comes
from a simulation, so the gap is never below that of an exact fit. For a faint effect the difference from an
exact fit is far less than the gap's own noise, whose standard deviation is about 2 √gap. For a strong effect
the number only shows that the baseline does not fit.

If rows are lost, the fit gets the true inputs: the gap is due to the effect, not to the loss.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import lsq_linear

from hidden_truth.effects import Hidden, with_effects
from hidden_truth.kernel import Array
from hidden_truth.recording import Recording, misfit, replay
from hidden_truth.rig import NUMBERS, TOLERANCE_PERCENT, WORN
from hidden_truth.truth import Truth

_NUDGE, _NUDGE_KPA = 1e-3, 0.1
_ROUNDS = 4
_SHARES = (1.0, 0.3, 0.05)
"""Shares of a step that are tried, until one lowers chi-square."""
KNOWN = (-0.7, 1.0)
"""The strength of a known effect may change by these shares."""
_ENOUGH, _ENOUGH_SHARE = 1.0, 0.01
"""If a round lowers chi-square by less than this, or by less than this share of the gap, it is the last."""


def chi_square(truth: Truth, recordings: Sequence[Recording]) -> float:
    """Chi-square of the truth itself, without a fit."""
    return sum(float(np.sum(misfit(truth, one, one.clean) ** 2)) for one in recordings)


def gap(
    truth: Truth, recordings: Sequence[Recording], known: tuple[Hidden, ...] = (), below: float = -np.inf
) -> float:
    """Chi-square of the baseline's best fit minus that of the truth; `known` effects are fitted as well.

    The search ends when the gap is below `below`.
    """
    numbers = [name for name in NUMBERS if getattr(truth.assumed, name) is not None]
    runs = len(recordings)

    def residuals(x: Array) -> list[Array]:
        moved = {name: getattr(truth.assumed, name) * (1.0 + x[i]) for i, name in enumerate(numbers)}
        strengths = x[len(numbers) + 2 * runs :]
        hidden = [Hidden(h.name, h.value * (1.0 + s)) for h, s in zip(known, strengths, strict=True)]
        p = with_effects(replace(truth.assumed, **moved), hidden)
        found = []
        for i, run in enumerate(recordings):
            d_reservoir, d_cv = x[len(numbers) + 2 * i : len(numbers) + 2 * i + 2]
            start = (run.start_kPa[0] + d_reservoir, run.start_kPa[1] + d_cv)
            found.append(misfit(truth, run, replay(p, run.inputs, run.time_s, start)))
        return found

    n = len(numbers) + 2 * runs + len(known)
    bound = np.full(n, np.inf)
    for i, name in enumerate(numbers):
        bound[i] = (truth.tolerance_percent if name in WORN else TOLERANCE_PERCENT) / 100.0
    if truth.assumed.cv_L is None:
        bound[len(numbers) + 1 : len(numbers) + 2 * runs : 2] = 0.0
    low, high = -bound, bound
    if known:
        low[-len(known) :], high[-len(known) :] = KNOWN
    noise = chi_square(truth, recordings)
    x = np.zeros(n)
    parts = residuals(x)
    best = np.concatenate(parts)
    if float(best @ best) - noise < below:
        return float(best @ best) - noise
    problem = _Linear(residuals, x, parts, len(numbers))
    for _ in range(_ROUNDS):
        before = float(best @ best)
        step = problem.step(best, low - x, high - x)
        for share in _SHARES:
            parts = residuals(x + share * step)
            now = np.concatenate(parts)
            if now @ now < best @ best:
                best, x = now, x + share * step
                break
        after = float(best @ best)
        if after - noise < below or before - after < max(_ENOUGH, _ENOUGH_SHARE * (after - noise)):
            break
        if known:
            problem = _Linear(residuals, x, parts, len(numbers))
    return float(best @ best) - noise


class _Linear:
    """The linear problem at a point, reduced to its unknowns: |root x − aim| equals |J x + b| except for a
    constant."""

    def __init__(
        self, residuals: Callable[[Array], list[Array]], at: Array, parts: list[Array], numbers: int
    ) -> None:
        self.jacobian = _jacobian(residuals, at, parts, numbers)
        self.scale = np.sqrt(np.einsum("ni,ni->i", self.jacobian, self.jacobian)) + 1e-30
        scaled = np.einsum("ni,nj->ij", self.jacobian, self.jacobian) / np.outer(self.scale, self.scale)
        values, self.vectors = np.linalg.eigh(scaled)
        self.roots = np.sqrt(np.maximum(values, 1e-12))

    def step(self, b: Array, low: Array, high: Array) -> Array:
        """The best step within bounds."""
        aim = self.vectors.T @ (np.einsum("ni,n->i", self.jacobian, -b) / self.scale) / self.roots
        bounds = ((low - 1e-12) * self.scale, (high + 1e-12) * self.scale)
        found = lsq_linear(self.roots[:, None] * self.vectors.T, aim, bounds).x / self.scale
        return np.asarray(found, dtype=np.float64)


def _jacobian(
    residuals: Callable[[Array], list[Array]], at: Array, parts: list[Array], numbers: int
) -> Array:
    """Finite differences. An initial pressure acts only on its own run, so those of all runs are changed at
    once."""
    runs = len(parts)
    jacobian = np.zeros((sum(one.size for one in parts), at.size))
    own = np.repeat(np.arange(runs), [one.size for one in parts])
    flat = np.concatenate(parts)
    for i in (*range(numbers), *range(numbers + 2 * runs, at.size)):
        x = at.copy()
        x[i] += _NUDGE
        jacobian[:, i] = (np.concatenate(residuals(x)) - flat) / _NUDGE
    for which in range(2):
        x = at.copy()
        x[numbers + which : numbers + 2 * runs : 2] += _NUDGE_KPA
        change = (np.concatenate(residuals(x)) - flat) / _NUDGE_KPA
        for run in range(runs):
            jacobian[own == run, numbers + 2 * run + which] = change[own == run]
    return jacobian
