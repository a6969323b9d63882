"""The recorded runs of a truth: simulated, with noise, rounded, without lost data."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hidden_truth.kernel import Array, Control, Physics, fly
from hidden_truth.plans import Plan, hanging
from hidden_truth.truth import Truth

TOLERANCE_KPA = 1e-6
"""Tolerance of each integrator step: at most 1e-5 kPa over a run."""
HOLE_S = 2.0
EMPTY_SHARE = 0.05
CV_DECIMALS, RESERVOIR_DECIMALS = 3, 2

Flags = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Recording:
    """One run: the truth, and its recorded part."""

    name: str
    time_s: Array
    command_kPa: Array
    inputs: Array
    """EVP, DVP, solenoid."""
    clean: Array
    """Readings of CV and reservoir without noise."""
    read: Array
    """Recorded readings; NaN for an empty cell."""
    kept: Flags
    """Recorded rows."""
    missing: frozenset[str]
    """Columns that are not recorded."""
    start_kPa: tuple[float, float]


def replay(p: Physics, inputs: Array, time_s: Array, start_kPa: tuple[float, float]) -> Array:
    """Readings without noise under given inputs: CV, reservoir."""
    n = time_s.size
    rows = np.column_stack([np.zeros(n), inputs])
    flown = fly(p, Control(False), start_kPa, time_s, rows, np.zeros((n, 2)), np.ones(n), TOLERANCE_KPA)
    readings: Array = flown[:, 3:5]
    return readings


def make(truth: Truth) -> tuple[Recording, ...]:
    """The recorded runs of a truth; always the same."""
    return tuple(_record(truth, i, plan) for i, plan in enumerate(truth.plans))


def _correlated(white: Array, time_s: Array, correlation_s: float) -> Array:
    """Noise of the same variance whose correlation falls by a factor of e in `correlation_s`."""
    if correlation_s == 0.0:
        return white
    noise = white.copy()
    stays = np.exp(-np.diff(time_s) / correlation_s)
    for i, share in enumerate(stays, start=1):
        noise[i] = share * noise[i - 1] + math.sqrt(1.0 - share * share) * white[i]
    return noise


def _record(truth: Truth, index: int, plan: Plan) -> Recording:
    rng = np.random.default_rng([*truth.stream, 1 + index])
    n = plan.time_s.size
    std_kPa = np.array([truth.noise.cv_kPa, truth.noise.reservoir_kPa])
    noise = _correlated(rng.standard_normal((n, 2)), plan.time_s, truth.correlation_s) * std_kPa
    chance = rng.random(n)
    hole = int(rng.integers(n // 10, n - n // 4))
    hole_samples = round(HOLE_S / np.median(np.diff(plan.time_s)))
    if truth.variant == "held":
        plan = hanging(plan, hole, hole_samples)
    start = (plan.reservoir_kPa, 0.0)
    flown = fly(truth.physics, plan.control, start, plan.time_s, plan.rows, noise, chance, TOLERANCE_KPA)
    exact = flown[:, 5:7]
    if truth.converter_step > 0.0:
        step_kPa = truth.converter_step * std_kPa
        exact = (exact / step_kPa).round() * step_kPa
    read = np.column_stack([exact[:, 0].round(CV_DECIMALS), exact[:, 1].round(RESERVOIR_DECIMALS)])
    kept = np.ones(n, dtype=bool)
    inputs = flown[:, :3].copy()
    if truth.variant == "cells":
        read[rng.random((n, 2)) < EMPTY_SHARE] = np.nan
        read[hole : hole + hole_samples] = np.nan
    elif truth.variant == "held":
        kept[1:] = rng.random(n - 1) >= EMPTY_SHARE
        kept[1:] |= np.any(np.diff(inputs, axis=0) != 0.0, axis=1)
        kept[flown[:, 7] > 0.0] = False
    elif truth.variant == "lost":
        kept[1:] = rng.random(n - 1) >= EMPTY_SHARE
        kept[hole : hole + hole_samples] = False
    missing = _missing(truth)
    if "cv_pressure_kPa" in missing:
        read[:, 0] = np.nan
    if "reservoir_pressure_kPa" in missing:
        read[:, 1] = np.nan
    return Recording(
        plan.name, plan.time_s, plan.rows[:, 0], inputs, flown[:, 3:5], read, kept, missing, start
    )


WITHOUT = {
    "without_command": "command_kPa",
    "without_dvp": "dvp_opening",
    "without_cv_pressure": "cv_pressure_kPa",
    "without_reservoir_pressure": "reservoir_pressure_kPa",
}
_ONLY_DISCHARGE = frozenset({"command_kPa", "evp_opening", "dvp_opening", "solenoid", "cv_pressure_kPa"})


def _missing(truth: Truth) -> frozenset[str]:
    if truth.variant == "discharge":
        return _ONLY_DISCHARGE
    return frozenset({WITHOUT[truth.variant]} if truth.variant in WITHOUT else ())


def misfit(truth: Truth, recording: Recording, model: Array) -> Array:
    """Recorded minus modelled readings, in standard deviations of the true noise."""
    off = (recording.read - model)[recording.kept] / (truth.noise.cv_kPa, truth.noise.reservoir_kPa)
    flat: Array = off[np.isfinite(off)]
    return flat
