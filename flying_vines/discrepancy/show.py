"""A verdict on a terminal."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from flying_vines.discrepancy.causes import catalogue
from flying_vines.discrepancy.verdict import NONE, UNEXPLAINED, Estimate, Verdict

RANKED = 8


def show(verdict: Verdict, console: Console) -> None:
    """Print the verdict in plain words, its evidence, and what was tried."""
    facts = Table.grid(padding=(0, 2))
    facts.add_column(style="bold")
    facts.add_column(overflow="fold")
    facts.add_row("Verdict", in_words(verdict))
    for name, estimates in (
        (verdict.cause, verdict.parameters),
        *((a.cause, a.parameters) for a in verdict.also),
    ):
        for parameter, estimate in estimates.items():
            facts.add_row(name, f"{parameter}  {_estimate(estimate)}")
    facts.add_row("Sure", f"{verdict.confidence:.0%}")
    if verdict.indistinguishable:
        facts.add_row("As well", ", ".join(verdict.indistinguishable))
    errors = verdict.held_out
    facts.add_row(
        "Unseen data",
        f"error {errors.nrmse_before:.2%} of the range before, {errors.nrmse_after:.2%} after; "
        f"noise alone {errors.noise_floor:.2%}",
    )
    if verdict.remainder:
        facts.add_row("What is left", f"depends most on {verdict.remainder}")
    if verdict.next_experiment:
        facts.add_row("Next", verdict.next_experiment)
    for remark in verdict.remarks:
        facts.add_row("Remark", remark)
    console.print(facts)
    console.print(_ranking(verdict))


def in_words(verdict: Verdict) -> str:
    """One or two sentences."""
    if verdict.cause == NONE:
        return "The baseline explains the data to within noise and tolerances."
    if verdict.cause == UNEXPLAINED:
        return "Something is there that no known cause accounts for."
    what = {cause.name: cause.what for cause in catalogue()}
    sentences = [what[verdict.cause], *(what[named.cause] for named in verdict.also)]
    return " And: ".join(sentences)


def _estimate(estimate: Estimate) -> str:
    return f"{estimate.estimate:.4g} ({estimate.low:.4g} … {estimate.high:.4g})"


def _ranking(verdict: Verdict) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), title="What was tried", title_justify="left")
    table.add_column("causes")
    table.add_column("−2 ln evidence above the best", justify="right")
    for ranked in verdict.ranking[:RANKED]:
        table.add_row(" + ".join(ranked.causes) or "none", f"{ranked.score:,.1f}")
    return table
