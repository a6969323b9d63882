"""The arrays behind a verdict, as pictures and notebooks want them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flying_vines.identification.intervals import LikelihoodProfile
from flying_vines.identification.likeness import Likeness, likeness
from flying_vines.identification.residuals import Pattern
from flying_vines.identification.search import SearchResult
from flying_vines.physics.arrays import Array


@dataclass(frozen=True, eq=False)
class Compared:
    """A run: measured, and simulated twice. Gauge pressures, kPa; (2, n), control volume then reservoir."""

    run: str
    time_s: Array
    """(n,)"""
    measured_kPa: Array
    """NaN where nothing was read."""
    baseline_kPa: Array
    """With the believed numbers refitted within their tolerances: the null."""
    extended_kPa: Array
    """With the causes that explain the data best; the baseline again if there are none."""
    openings: Array
    """(3, n) what the valves were told: inflation valve, Venturi's valve (0…1), solenoid (0 or 1)."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a verdict rests on."""

    runs: tuple[Compared, ...]
    noise_kPa: tuple[float, float]
    """Of control volume's and reservoir's readings, as used."""
    before: tuple[Pattern, ...]
    """What the baseline's residuals depend on, the strongest first."""
    after: tuple[Pattern, ...]
    """What is left of it with the causes."""
    profiles: tuple[LikelihoodProfile, ...]
    """Of the named causes' parameters."""
    likeness: Likeness
    """Of the whole catalogue, around what fits best."""


def evidence(found: SearchResult, profiles: Sequence[LikelihoodProfile]) -> Evidence:
    """Of a search that has ended."""
    null, chosen = found.search.null, found.chosen
    problem = chosen.problem
    simulated = zip(problem.simulated(null.fit.point), problem.simulated(chosen.fit.point), strict=True)
    runs = []
    for i, (baseline_kPa, extended_kPa) in enumerate(simulated):
        measured_kPa = np.where(problem.weights[i] > 0.0, problem.data[i], np.nan)
        run = problem.case.runs[i]
        openings = np.stack((run.evp_opening, run.dvp_opening, run.solenoid))
        runs.append(Compared(run.name, run.time_s, measured_kPa, baseline_kPa, extended_kPa, openings))
    return Evidence(
        runs=tuple(runs),
        noise_kPa=problem.noise_kPa,
        before=tuple(null.patterns),
        after=tuple(chosen.patterns),
        profiles=tuple(profiles),
        likeness=likeness(problem, chosen.fit, found.search.catalogue, found.search.keys),
    )
