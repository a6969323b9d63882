"""The diagnosis of the paper's data on a terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from flying_vines.studies.paper.diagnosis import PaperDiagnosis
from flying_vines.studies.paper.diagnosis.discharge import NOISES, Discharges
from flying_vines.studies.paper.diagnosis.experiment import ExperimentProposal
from flying_vines.studies.paper.diagnosis.response import Responses
from flying_vines.studies.paper.diagnosis.verdict import findings

ACCOUNTS = 6
SHOWN = {("gain_floor",), ("tube",), ("cv_heating",), ("evp_restriction",), ()}
"""Accounts that are shown whatever their rank is."""


def show(diagnosis: PaperDiagnosis, console: Console) -> None:
    """Print the findings and the evidence."""
    console.print("What the baseline gets wrong, by the paper's measurements", style="bold")
    for number, text in enumerate(findings(diagnosis), 1):
        item = Table.grid(padding=(0, 1))
        item.add_row(f"{number}.", Text(text))
        console.print(Padding(item, (0, 0, 0, 1)))
    console.print(_candidates(diagnosis.discharges))
    console.print(
        "−2 ln of the evidence relative to the best, for each kind of assumed error; green: named, yellow: "
        "not separated from the best. Rms: least squares. Predicted: each series from the two others."
    )
    console.print(_experiments(diagnosis.proposal))
    console.print(_accounts(diagnosis.responses))


def _table(title: str, columns: Sequence[str], words: Sequence[int] = (0,)) -> Table:
    """A table with columns of numbers; columns in `words` may use several lines."""
    table = Table(box=None, padding=(0, 1), pad_edge=False, title=title, title_justify="left")
    for number, heading in enumerate(columns):
        is_words = number in words
        table.add_column(heading, justify="left" if is_words else "right", no_wrap=not is_words)
    return table


def _candidates(found: Discharges) -> Table:
    table = _table("\nDischarges", ("causes", *NOISES, "rms, kPa", "predicted, %"))
    possible = found.open()
    for candidate in found.candidates:
        style = "green" if candidate is found.named else "yellow" if candidate in possible else ""
        table.add_row(
            Text(candidate.label, style=style),
            *(f"{above:.1f}" for above in found.above(candidate)),
            f"{candidate.rms_kPa:.1f}",
            " ".join(f"{p:.1f}" for p in candidate.predicted_percent),
        )
    return table


def _experiments(proposal: ExperimentProposal) -> Table:
    columns = ("experiment", "lowest Δχ²", "with rounding only", "if true", "fitted")
    table = _table("\nA minute at the bench", columns, words=(0, 3, 4))
    for outcome in proposal.outcomes:
        worst = outcome.worst
        table.add_row(
            Text(outcome.experiment.name, style="green" if outcome is proposal.best else ""),
            f"{worst.delta_chi2:.1f}",
            f"{worst.delta_chi2_rounding:,.1f}",
            " + ".join(worst.true),
            " + ".join(worst.fitted),
        )
    return table


def _accounts(responses: Responses) -> Table:
    columns = ("what", "above best", "off, dB rms", "in band", "at")
    table = _table("\nFrequency responses: TC4, and TC5 on 345 kPa", columns)
    shown = {account.names for account in responses.accounts[:ACCOUNTS]} | SHOWN
    for account in responses.accounts:
        if account.names in shown:
            table.add_row(
                account.label,
                f"{responses.above(account):.1f}",
                " ".join(f"{value:.2f}" for value in account.rms_dB),
                " ".join(f"{value:.2f}" for value in account.band_rms_dB),
                " ".join(f"{value:g}" for value in account.best.values()),
            )
    return table
