"""The head of a report: what is wrong with the simulation, how sure that is, and what it is worth."""

from __future__ import annotations

from flying_vines.identification.report.canvas import models
from flying_vines.identification.report.markup import Html, bold, code, facts, joined, paragraph, safe, small
from flying_vines.identification.report.words import label_and_unit, numbers, share
from flying_vines.identification.show import in_words
from flying_vines.identification.verdict import NONE, UNEXPLAINED, Named, Verdict


def answer(verdict: Verdict, case_name: str) -> Html:
    """In plain words, then in numbers."""
    return joined(
        (
            paragraph("Baseline simulation against recorded runs: ", case_name, kind="eyebrow"),
            Html(f"<h1>{safe(in_words(verdict))}</h1>\n"),
            paragraph(*_lede(verdict), kind="lede"),
            facts(
                (
                    *((code(cause.cause), _measured(cause)) for cause in verdict.named),
                    ("What is left", _remainder(verdict)),
                    ("As well possible", _alike(verdict)),
                    ("Next experiment", verdict.next_experiment),
                    ("Remarks", Html("<br>".join(safe(remark) for remark in verdict.remarks))),
                )
            ),
        )
    )


def _lede(verdict: Verdict) -> list[str]:
    errors = verdict.held_out
    before, after, floor = (share(e) for e in (errors.nrmse_before, errors.nrmse_after, errors.noise_floor))
    sure = bold(f"{100.0 * verdict.confidence:.0f} % sure")
    if verdict.cause == NONE:
        return [
            sure,
            f". On data that its fit never saw the baseline errs by {before} of the measured range; ",
            f"noise alone makes {floor}. No cause was found that the data ask for.",
        ]
    gain = f"{100.0 * errors.gain[0]:.0f} … {100.0 * errors.gain[1]:.0f} %"
    if verdict.cause == UNEXPLAINED:
        if not models(verdict):
            return [
                sure,
                f". On unseen data the baseline errs by {before} of the measured range, where noise alone "
                f"makes {floor}, and no cause of the catalogue takes it away.",
            ]
        return [
            sure,
            ". The nearest is ",
            code(models(verdict)),
            f": on unseen data it brings the error from {before} of the measured range down to {after}. But "
            f"noise alone makes {floor}: it does not account for ",
            "what was recorded, so its numbers below are no measurement.",
        ]
    further = [code(also.cause) for also in verdict.also]
    return [
        code(verdict.cause),
        ": ",
        sure,
        " that it is this cause"
        if not verdict.indistinguishable
        else " that it is this cause or one of those below",
        *([", and beside it ", joined(further, " and ")] if further else []),
        ". On data that the fit never saw, the error falls from ",
        bold(before),
        " of the measured range to ",
        bold(after),
        f", where noise alone makes {floor}: {gain} of it is gone (95 % interval).",
    ]


def _measured(cause: Named) -> Html:
    said = []
    for name, estimate in cause.parameters.items():
        label, unit = label_and_unit(name)
        value, low, high = numbers(estimate)
        said.append(joined((f"{label} ", bold(value), f" {unit} ", small(f"(95 %: {low} … {high})"))))
    return joined(said, Html("<br>"))


def _remainder(verdict: Verdict) -> str:
    if not verdict.remainder:
        return ""
    return joined((bold(verdict.remainder), ": on this the residuals of the best fit depend most."))


def _alike(verdict: Verdict) -> str:
    if not verdict.indistinguishable:
        return ""
    others = joined((code(name) for name in verdict.indistinguishable), ", ")
    return joined((others, " ", small("These data cannot tell it from the one named.")))
