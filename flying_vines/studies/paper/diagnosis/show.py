"""The diagnosis of the paper's data on a terminal."""

from __future__ import annotations

from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from flying_vines.identification.show import show as show_verdict
from flying_vines.studies.paper.diagnosis import PaperDiagnosis
from flying_vines.studies.paper.diagnosis.response import Responses
from flying_vines.studies.paper.diagnosis.words import findings

MAX_EXPLANATIONS = 6
SHOWN = {("gain_floor",), ("tube",), ("cv_heating",), ("evp_restriction",), ()}
"""Explanations that are shown whatever their rank is."""


def show(diagnosis: PaperDiagnosis, console: Console) -> None:
    """Print the findings, the verdict on the discharges, and the gains."""
    console.print("What the baseline gets wrong, by the paper's measurements", style="bold")
    for number, text in enumerate(findings(diagnosis), 1):
        item = Table.grid(padding=(0, 1))
        item.add_row(f"{number}.", Text(text))
        console.print(Padding(item, (0, 0, 0, 1)))
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
