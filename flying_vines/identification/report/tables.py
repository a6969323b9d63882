"""The tables of a report: everything that was tried, what the residuals depend on, the rig and the runs."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import version
from platform import python_version

import numpy as np

from flying_vines.identification.case import Case
from flying_vines.identification.report.canvas import models, residuals
from flying_vines.identification.report.dependence import same, strongest
from flying_vines.identification.report.markup import Html, Row, code, joined, small, table
from flying_vines.identification.report.words import (
    how_surprising,
    label_and_unit,
    labelled,
    numbers,
    rounded,
    share,
    signed,
)
from flying_vines.identification.residuals import Pattern
from flying_vines.identification.simulate import believed_keys
from flying_vines.identification.verdict import UNEXPLAINED, Tried, Verdict

_LIBRARIES = ("flying-vines", "numpy", "scipy", "numba", "matplotlib")


def tried_table(verdict: Verdict) -> Html:
    """Every candidate that was fitted, the best evidence first."""
    chosen = None if verdict.cause == UNEXPLAINED else {cause.cause for cause in verdict.named}
    rows = [
        Row(
            (
                joined((code(cause) for cause in tried.causes), " + ") if tried.causes else "baseline",
                joined(_measures(tried), Html("<br>")),
                rounded(tried.chi2_per_reading),
                rounded(0.5 * tried.score),
                "" if tried.unseen_nrmse is None else share(tried.unseen_nrmse),
            ),
            chosen=set(tried.causes) == chosen,
        )
        for tried in verdict.ranking
    ]
    return table(("what was fitted", "measures (95 % interval)", "χ²/n>", "evidence>", "unseen>"), rows)


def _measures(tried: Tried) -> Iterator[Html]:
    for cause in tried.named:
        for name, estimate in cause.parameters.items():
            label, unit = label_and_unit(name)
            value, low, high = numbers(estimate)
            bound = ", on its bound" if name in tried.on_bound else ""
            yield joined((f"{label} {value} ", small(f"({low} … {high})"), f" {unit}".rstrip(), bound))


def dependence_table(verdict: Verdict) -> Html:
    """In words, what the pictures of the dependence show."""
    evidence = verdict.evidence
    columns = ["channel", "depends on", "baseline"] + (["extended"] if models(verdict) else [])
    rows = []
    for pattern in strongest(verdict):
        before, after = (_how_much(same(pattern, found)) for found in (evidence.before, evidence.after))
        rows.append(Row((pattern.channel, pattern.feature, before, after)[: len(columns)]))
    return table(columns, rows)


def _how_much(pattern: Pattern | None) -> Html | str:
    if pattern is None:
        return ""
    largest = float(pattern.mean[np.argmax(np.abs(pattern.mean))])
    size = f"{largest:+,.0f}" if abs(largest) >= 10.0 else f"{largest:+.2g}"
    return joined((f"up to {signed(size)}σ; ", small(how_surprising(pattern))))


def rig_table(verdict: Verdict, case: Case) -> Html:
    """The believed rig, the numbers that the fit moved within their tolerances, and the noise."""
    rows = []
    for key in believed_keys(case.rig):
        group, name = key.split(".")
        believed = getattr(getattr(case.rig, group), name)
        fitted = "as believed"
        if key in verdict.numbers:
            moved = signed(f"{100.0 * (verdict.numbers[key] / believed - 1.0):+.2f}")
            fitted = f"{verdict.numbers[key]:,.5g} ({moved} %)"
        tolerance = f"± {case.rig.tolerance(key):g} %"
        rows.append(Row((group, labelled(name), f"{believed:,.5g}", tolerance, fitted)))
    for group, used in zip(("cv", "reservoir"), verdict.evidence.noise_kPa, strict=True):
        if group == "reservoir" or case.rig.cv is not None:
            stated = getattr(case.rig.sensors, f"{group}_noise_std_kPa")
            noise = "as believed" if used == stated else f"{used:.3g} in the data"
            rows.append(Row((group, "noise of its readings, kPa", f"{stated:g}", "", noise)))
    columns = ("", "number", "believed>", "tolerance>", "as fitted>")
    # A fit that does not account for the data says nothing of the rig.
    kept = len(columns) - (verdict.cause == UNEXPLAINED)
    return table(columns[:kept], [Row(row.cells[:kept]) for row in rows])


def runs_table(verdict: Verdict) -> Html:
    """What was read of each run, and how far off either model is."""
    columns = ["", "run", "seconds>", "samples>", "readings>", "rms, baseline>"] + (
        ["rms, extended>"] if models(verdict) else []
    )
    rows = []
    for number, run in enumerate(verdict.evidence.runs, start=1):
        readings = np.isfinite(run.measured_kPa).sum(axis=1)
        cells = [
            str(number),
            run.run,
            f"{run.time_s[-1] - run.time_s[0]:,.1f}",
            f"{len(run.time_s):,}",
            " + ".join(f"{count:,}" for count in readings),
        ]
        for extended in (False, True)[: 1 + bool(models(verdict))]:
            both = np.concatenate(
                [residuals(run, row, verdict.evidence.noise_kPa)[extended] for row in range(len(readings))]
            )
            cells.append(f"{rounded(float(np.sqrt(np.nanmean(both**2))))} σ")
        rows.append(Row(cells))
    return table(columns, rows)


def versions() -> str:
    """With what this was worked out."""
    return ", ".join([f"Python {python_version()}", *(f"{name} {version(name)}" for name in _LIBRARIES)])
