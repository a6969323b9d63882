"""The page: from the answer down to what it rests on."""

from __future__ import annotations

from collections.abc import Mapping

from flying_vines.identification.case import Case
from flying_vines.identification.held_out import STRETCH_S
from flying_vines.identification.report import captions
from flying_vines.identification.report.answer import answer
from flying_vines.identification.report.canvas import models
from flying_vines.identification.report.markup import (
    Html,
    bullets,
    document,
    heading,
    joined,
    paragraph,
    picture,
)
from flying_vines.identification.report.sheet import STYLE
from flying_vines.identification.report.tables import (
    dependence_table,
    rig_table,
    runs_table,
    tried_table,
    versions,
)
from flying_vines.identification.search import CLAIM, STRUCTURE
from flying_vines.identification.show import in_words
from flying_vines.identification.verdict import NONE, UNEXPLAINED, Verdict

DECIDES = (
    "The baseline may move every believed number within its tolerance and start each run at pressures of "
    "its own; what it then cannot do is held against it.",
    "Every cause of the catalogue is simulated and fitted, all runs at once, with inputs as recorded; "
    "where more than noise is left, two and three together.",
    "A cause has to pay: χ² plus what its parameters and the moved numbers cost in evidence (Laplace) must "
    f"fall by {CLAIM:g}.",
    "What is left is looked at by time, time since each valve turned, opening, pressure and rate. If it is "
    f"more than noise leaves once in {10.0**STRUCTURE:,.0f} times, the verdict is “unexplained”, whatever "
    "fitted best.",
    "Unseen data: each run is predicted from a fit to the others; where those do not fix a parameter, "
    f"every other stretch of {STRETCH_S:g} s from the rest.",
)


def page(verdict: Verdict, case: Case, pictures: Mapping[str, bytes]) -> str:
    """The whole report.

    Args:
        pictures: SVG by the names of `figures`.
    """
    name = case.path.resolve().name

    def shown(key: str, alt: str, caption: str) -> str:
        return picture(pictures[key], alt, caption) if key in pictures else ""

    body = (
        answer(verdict, name),
        shown("unseen", "Errors on unseen data", captions.unseen(verdict)),
        heading("Measured, and simulated"),
        _all_runs(verdict, pictures),
        *(
            shown(f"run-{n}", f"Run {n}: pressures and openings over time", captions.run(verdict, n))
            for n in range(1, len(verdict.evidence.runs) + 1)
        ),
        heading("What is left: noise, or more?"),
        shown("residuals", "Residuals over time, and their histograms", captions.left(verdict)),
        shown("autocorrelation", "Autocorrelation of the residuals", captions.autocorrelation(verdict)),
        heading(_dependence(verdict)),
        shown("dependence", "Mean residuals of groups of samples", captions.dependence(verdict)),
        dependence_table(verdict),
        heading("What could explain it"),
        shown("ranking", "Candidates by evidence", captions.ranking(verdict)),
        heading("How well the data fix it") if "profiles" in pictures else "",
        shown("profiles", "Profiles of χ²", captions.profiles(verdict)),
        heading("What these data can tell apart"),
        shown("likeness", "Likeness of the causes' traces", captions.likeness(verdict)),
        bullets(captions.told_apart(verdict)),
        heading("Everything that was tried"),
        paragraph(
            "Evidence: its natural logarithm, behind the best. Unseen: error on data that the fit never "
            "saw, for the best few. Intervals here are from the curvature of χ²; for causes that no fit has "
            "use for they mean little."
        ),
        tried_table(verdict),
        heading("The rig and the runs"),
        rig_table(verdict, case),
        runs_table(verdict),
        paragraph(
            "Readings: of the control volume + of the reservoir. rms: of both, in standard deviations of "
            "noise."
        ),
        heading("How it decides"),
        bullets(DECIDES),
        Html(
            f"<footer>{versions()}. Pressures are gauge. This page holds all that it shows, and asks nothing "
            "of a network.</footer>\n"
        ),
    )
    return document(f"{in_words(verdict)} {name}", STYLE, joined(part for part in body if part))


def _dependence(verdict: Verdict) -> str:
    if verdict.cause == NONE:
        return "Does what is left depend on anything?"
    return (
        "What the rest depends on" if verdict.cause == UNEXPLAINED else "What the baseline's error depends on"
    )


def _all_runs(verdict: Verdict, pictures: Mapping[str, bytes]) -> Html:
    drawn = sum(name.startswith("run-") for name in pictures)
    every = len(verdict.evidence.runs)
    if drawn == every:
        return Html("")
    which = (
        "in which the two models part most" if models(verdict) else "in which the baseline is furthest off"
    )
    return paragraph(f"Of {every} runs these are the {drawn} {which}.")
