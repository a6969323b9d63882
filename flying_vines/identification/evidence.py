"""The arrays behind a verdict, for figures and notebooks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flying_vines.identification.intervals import LikelihoodProfile
from flying_vines.identification.residuals import Pattern
from flying_vines.identification.search import SearchResult
from flying_vines.identification.similarity import Similarity, similarity
from flying_vines.physics.arrays import Array


@dataclass(frozen=True, eq=False)
class Compared:
    """A run, measured and simulated. Pressures are (2, n), kPa gauge: control volume, then reservoir."""

    run: str
    time_s: Array
    """(n,)"""
    measured_kPa: Array
    """NaN where nothing was read."""
    baseline_kPa: Array
    """The null model: the baseline with nominal rig numbers, or with numbers refitted within tolerances."""
    extended_kPa: Array
    """With the causes that explain the data best; the null model again if there are none."""
    openings: Array
    """(3, n) valve commands: inflation valve, Venturi's valve (0…1), solenoid (0 or 1)."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """The data on which a verdict is based."""

    runs: tuple[Compared, ...]
    noise_kPa: tuple[float, float]
    """Standard deviations for control volume and reservoir that the fit used."""
    before: tuple[Pattern, ...]
    """Residual patterns of the null model, the strongest first."""
    after: tuple[Pattern, ...]
    """Residual patterns with the causes."""
    profiles: tuple[LikelihoodProfile, ...]
    """One per parameter of the best fit; an `unexplained` verdict does not name the causes of that fit."""
    similarity: Similarity
    """Similarity of all causes of the catalogue, around the best fit."""


def evidence(found: SearchResult, profiles: Sequence[LikelihoodProfile]) -> Evidence:
    """The evidence of a finished search."""
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
        similarity=similarity(problem, chosen.fit, found.search.catalogue, found.search.keys),
    )
