"""The diagnosis of the paper's data: in words, on a terminal, and as plain data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

from flying_vines.identification.show import show as show_verdict
from flying_vines.studies.paper.data import stated
from flying_vines.studies.paper.diagnosis import PaperDiagnosis
from flying_vines.studies.paper.diagnosis.discharge import RIG, Discharges, LawFit
from flying_vines.studies.paper.diagnosis.response import (
    FLOOR,
    OTHER_SUPPLY_KPA,
    SUPPLY_KPA,
    GainExplanation,
    Responses,
)
from flying_vines.studies.paper.report import item

MAX_EXPLANATIONS = 6
SHOWN = {("gain_floor",), ("tube",), ("cv_heating",), ("evp_restriction",), ()}
"""Explanations that are shown whatever their rank is."""


def findings(diagnosis: PaperDiagnosis) -> tuple[str, ...]:
    """The named cause, the open questions, and the experiments for them: one text each."""
    found = diagnosis.discharges
    return (
        _named(found),
        _further(found),
        _flow_law(found.laws),
        _experiment(found),
        *_responses(diagnosis.responses),
    )


def _named(found: Discharges) -> str:
    scale, errors = found.verdict.parameters["scale"], found.verdict.held_out
    rated_SLPM = 60.0 * stated()["reservoir.pressure"].value / RIG.evp.flow_resistance_kPa_s_per_SL
    alone = sorted(found.scale_alone.values())
    return (
        f"Discharges: air leaves faster than with the paper's R_v. The best R_v is {scale.estimate:.2f} "
        f"({scale.low:.2f} … {scale.high:.2f}) of the paper's: {rated_SLPM / scale.estimate:.1f} SLPM at 690 "
        f"kPa, where the EVP is rated for {stated()['evp.flow'].value:g}. Fits to single series give "
        f"{alone[0]:.2f} to {alone[-1]:.2f}, a wider range. With each series predicted from the others, "
        f"the error falls from {errors.nrmse_before:.1%} to {errors.nrmse_after:.1%} of the range "
        f"(by {errors.gain[0]:.0%} to {errors.gain[1]:.0%}). A smaller reservoir has the same "
        "effect: weigh it full of water."
    )


def _further(found: Discharges) -> str:
    second = [
        f"{each.cause} {each.unseen_nrmse:.2%} ({-each.gain[1]:+.0%} … {-each.gain[0]:+.0%})"
        for each in found.second
    ]
    left = found.verdict.remainder.share if found.verdict.remainder else 0.0
    return (
        f"Whether there is a second cause stays open; {left:.0%} of the error remains. All series are "
        "steeper at first and flatter later than with the best R_v. Errors with a second cause, each series "
        f"predicted from the others, and their changes: {'; '.join(second)}. No improvement is sure."
    )


def _flow_law(laws: Sequence[LawFit]) -> str:
    texts = [
        f"{law.ohm_kPa:.1f} and {law.choked_kPa:.1f} kPa with a ratio of {law.settings_ratio:.2f} and first "
        f"readings {'taken as exact' if law.first_exact else 'as uncertain as all others'}"
        for law in laws
    ]
    return (
        "Whether the valve chokes stays open. Ohm's law and choked flow, each with gas that cools, leave "
        f"{'; '.join(texts)}. So the better law changes if the first readings are not taken as exact, or "
        f"with another ratio of the valve's two settings. Choked flow needs {laws[0].choked_scale:.2f} of "
        "the paper's R_v."
    )


def _experiment(found: Discharges) -> str:
    return (
        f"To separate heat, leak, R_v and law of flow: {found.recommended.in_words()} In the rests the "
        "reading rises if the gas had cooled, jumps if the sensor is in the flow, and stays if the valve "
        "settles."
    )


def _responses(responses: Responses) -> tuple[str, ...]:
    null, floor, tube = responses.of(), responses.of(FLOOR), responses.of("tube")
    alone = [a for a in responses.explanations if len(a.names) == 1 and a.names[0] not in (FLOOR, "tube")]
    best = min(alone, key=lambda explanation: explanation.unseen)
    other_floor, other_tube = (responses.of(name, other=True) for name in (FLOOR, "tube"))
    better = sum(explanation.unseen < floor.unseen for explanation in responses.explanations)
    return (
        "Frequency responses: the baseline under the paper's regulator is "
        f"{_dB(null.rms_dB)} dB rms off TC4 and TC5, {_dB(null.band_rms_dB)} up to three cut-offs. The "
        "baseline lacks the flat tail of the measured gains. A floor, a minimum gain of "
        f"{floor.best[FLOOR]:g}, from drift in an FFT over few cycles, predicts each test from the other to "
        f"{_dB(floor.unseen_dB)} dB; a tube between sensor and vessel to {_dB(tube.unseen_dB)}; the best "
        f"single cause of the catalogue, {best.label}, to {_dB(best.unseen_dB)}. The paper states "
        "345 and 690 kPa as the supply of TC5; these numbers are for 345 kPa. On 690 kPa the floor predicts "
        f"to {_dB(other_floor.unseen_dB)} dB and the tube to {_dB(other_tube.unseen_dB)}.",
        f"With a floor, no further cause is sure: {better} of {len(responses.explanations)} explanations "
        f"predict better, by at most {floor.unseen - responses.explanations[0].unseen:.1f} dB. The paper "
        "does not print the regulator's PID, the valve drivers, the tubes, the outlet, or any phase. A "
        "record of one test over many whole cycles would separate a floor from a tube.",
    )


def _dB(values: Sequence[float]) -> str:
    return " and ".join(f"{value:.2f}" for value in values)


def as_json(diagnosis: PaperDiagnosis) -> dict[str, Any]:
    """The findings and numbers as plain lists, numbers and texts."""
    found, responses = diagnosis.discharges, diagnosis.responses
    return {
        "findings": list(findings(diagnosis)),
        "discharge": {
            **found.verdict.as_json(),
            "scale_alone": found.scale_alone,
            "second": [each._asdict() for each in found.second],
            "flow_laws": [vars(law) for law in found.laws],
        },
        "frequency": [_explanation(explanation, SUPPLY_KPA["tc5"]) for explanation in responses.explanations]
        + [_explanation(explanation, OTHER_SUPPLY_KPA["tc5"]) for explanation in responses.other],
    }


def _explanation(explanation: GainExplanation, tc5_supply_kPa: float) -> dict[str, Any]:
    return {
        "causes": list(explanation.names),
        "tc5_supply_kPa": tc5_supply_kPa,
        "best": explanation.best,
        "rms_dB": list(explanation.rms_dB),
        "band_rms_dB": list(explanation.band_rms_dB),
        "unseen_dB": list(explanation.unseen_dB),
    }


def show(diagnosis: PaperDiagnosis, console: Console) -> None:
    """Print the findings, the verdict on the discharges, and the gains."""
    console.print("What the baseline gets wrong, by the paper's measurements", style="bold")
    for number, text in enumerate(findings(diagnosis), 1):
        item(console, f"{number}.", text)
    console.print("\nDischarges", style="bold")
    show_verdict(diagnosis.discharges.verdict, console)
    console.print(_explanations(diagnosis.responses))


def _explanations(responses: Responses) -> Table:
    table = Table(
        box=None,
        padding=(0, 1),
        pad_edge=False,
        title="\nFrequency responses: TC4, and TC5 on 345 kPa, dB rms",
        title_justify="left",
    )
    table.add_column("what")
    for heading in ("unseen", "all points", "in band", "at"):
        table.add_column(heading, justify="right", no_wrap=True)
    shown = {explanation.names for explanation in responses.explanations[:MAX_EXPLANATIONS]} | SHOWN
    for explanation in responses.explanations:
        if explanation.names in shown:
            table.add_row(
                explanation.label,
                " ".join(f"{value:.2f}" for value in explanation.unseen_dB),
                " ".join(f"{value:.2f}" for value in explanation.rms_dB),
                " ".join(f"{value:.2f}" for value in explanation.band_rms_dB),
                " ".join(f"{value:g}" for value in explanation.best.values()),
            )
    table.caption = "unseen: each test with the values that are best for the other"
    table.caption_justify = "left"
    return table
