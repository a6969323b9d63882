"""The pictures of a verdict, by name, for a report or a notebook."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from flying_vines.identification.report.canvas import channels, models, typeset
from flying_vines.identification.report.dependence import draw_dependence, strongest
from flying_vines.identification.report.left import draw_autocorrelation, draw_residuals
from flying_vines.identification.report.likeness import by_likeness, draw_likeness
from flying_vines.identification.report.profiles import draw_profiles
from flying_vines.identification.report.ranking import draw_ranking
from flying_vines.identification.report.runs import draw_run, parting
from flying_vines.identification.report.unseen import draw_unseen
from flying_vines.identification.verdict import Verdict

MOST_RUNS = 6


def figures(verdict: Verdict) -> dict[str, Figure]:
    """All that can be drawn of a verdict, in the order in which it convinces.

    Args:
        verdict: of `diagnose`; all arrays are in `verdict.evidence`.

    Returns:
        by name: `unseen`, `run-1`… (of `verdict.evidence.runs`, counted from 1), `residuals`,
        `autocorrelation`, `dependence`, `ranking`, `profiles` (only where a cause was fitted) and
        `likeness`. Gauge pressures in kPa, residuals in standard deviations of the noise. The figures belong
        to no window and need not be closed: `figure.savefig("run.pdf")`.
    """
    evidence = verdict.evidence
    model = models(verdict)
    with typeset():
        drawn = {"unseen": draw_unseen(verdict)}
        for index in shown_runs(verdict):
            drawn[f"run-{index + 1}"] = draw_run(evidence.runs[index], evidence.noise_kPa, model)
        if channels(verdict):
            drawn["residuals"] = draw_residuals(verdict)
            drawn["autocorrelation"] = draw_autocorrelation(verdict)
        if strongest(verdict):
            drawn["dependence"] = draw_dependence(verdict)
        drawn["ranking"] = draw_ranking(verdict)
        if evidence.profiles:
            drawn["profiles"] = draw_profiles(verdict)
        if len(by_likeness(evidence.likeness)) > 1:
            drawn["likeness"] = draw_likeness(verdict)
    return drawn


def shown_runs(verdict: Verdict) -> list[int]:
    """Indices of the runs that are drawn: where there are many, those in which the simulations part most."""
    evidence = verdict.evidence
    parts = [float(np.mean(parting(run, evidence.noise_kPa, models(verdict)) ** 2)) for run in evidence.runs]
    return sorted(sorted(range(len(parts)), key=lambda i: -parts[i])[:MOST_RUNS])
