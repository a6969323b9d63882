"""Prints a verdict on a terminal."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from flying_vines.identification.verdict import NONE, UNEXPLAINED, ParameterEstimate, Remainder, Verdict
from flying_vines.physics.effects import catalogue

RANKED = 8


def show(verdict: Verdict, console: Console) -> None:
    """Print the verdict in words, its numbers, and the best candidates."""
    facts = Table.grid(padding=(0, 2))
    facts.add_column(style="bold")
    facts.add_column(overflow="fold")
    facts.add_row("Verdict", in_words(verdict))
    several = len(verdict.named) > 1
    for named in verdict.named:
        if several:
            facts.add_row(named.cause, _what(named.cause))
        for parameter, estimate in named.parameters.items():
            facts.add_row("" if several else named.cause, f"{parameter}  {_estimate(estimate)}")
    facts.add_row("Confidence", f"{verdict.confidence:.0%}")
    if verdict.indistinguishable:
        facts.add_row("Or", ", ".join(verdict.indistinguishable))
    errors = verdict.held_out
    facts.add_row(
        "Unseen data",
        f"error {errors.nrmse_before:.2%} of the range before, {errors.nrmse_after:.2%} after; "
        f"noise alone {errors.noise_floor:.2%}",
    )
    if verdict.remainder:
        facts.add_row("Residuals", f"depend most on {verdict.remainder.depends_on}")
    if verdict.next_experiment:
        facts.add_row("Next", verdict.next_experiment)
    for cause in catalogue():
        if cause.name == verdict.cause:
            facts.add_row("Shown by", cause.experiment)
    for remark in verdict.remarks:
        facts.add_row("Remark", remark)
    console.print(facts)
    console.print(_ranking(verdict))


def in_words(verdict: Verdict) -> str:
    """The verdict in one or two sentences."""
    if verdict.cause == NONE:
        return "The baseline explains the data to within noise and tolerances."
    if verdict.cause == UNEXPLAINED:
        return "No known cause explains the difference between data and simulation." + _nearest(verdict)
    main, *further = verdict.named
    if not further:
        text = _what(main.cause)
    else:
        shares = [f"{named.cause} ({_percent(named.share or 0.0)})" for named in verdict.named]
        mostly = (main.share or 0.0) >= 0.5
        text = f"Mostly {', then '.join(shares)}." if mostly else f"Several causes: {', '.join(shares)}."
    return text + (f" {_sentence(verdict.remainder)}" if verdict.remainder else "")


def _sentence(remainder: Remainder) -> str:
    return f"{_percent(remainder.share).capitalize()} of the error remains."


def _what(name: str) -> str:
    """The difference in the rig, in words; the name itself for a cause from elsewhere."""
    return next((cause.what for cause in catalogue() if cause.name == name), name)


def _percent(share: float) -> str:
    return "less than 1 %" if share < 0.01 else f"{100.0 * share:.0f} %"


def _nearest(verdict: Verdict) -> str:
    """A sentence about the candidate with the best evidence; empty if that is the baseline."""
    baseline = next((tried for tried in verdict.ranking if not tried.causes), None)
    if baseline is None:  # Its simulation diverged: there is no error to compare with.
        return ""
    best = verdict.ranking[0]
    over_noise = baseline.chi2_per_reading - 1.0
    if not best.causes or over_noise <= 0.0:
        return ""
    share = (baseline.chi2_per_reading - best.chi2_per_reading) / over_noise
    causes = " with ".join(best.causes)
    return f" The best candidate, {causes}, explains {min(share, 1.0):.1%} of the error above noise."


def _estimate(estimate: ParameterEstimate) -> str:
    return f"{estimate.estimate:.4g} ({estimate.low:.4g} … {estimate.high:.4g})"


def _ranking(verdict: Verdict) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), title="Candidates, the best first", title_justify="left")
    table.add_column("cause and parameters", overflow="fold")
    table.add_column("χ²/n", justify="right")
    table.add_column("unseen", justify="right")
    table.add_column("evidence", justify="right")
    for tried in verdict.ranking[:RANKED]:
        measures = [
            f"  {name} {_estimate(estimate)}" + (", on its bound" if name in tried.on_bound else "")
            for named in tried.named
            for name, estimate in named.parameters.items()
        ]
        table.add_row(
            "\n".join([" + ".join(tried.causes) or NONE, *measures]),
            f"{tried.chi2_per_reading:.3f}",
            "" if tried.unseen_nrmse is None else f"{tried.unseen_nrmse:.2%}",
            f"{-tried.score / 2.0:,.1f}" if tried.score else "best",
        )
    table.caption = (
        "evidence: natural logarithm, relative to the best; unseen: error on data that the fit has not seen"
    )
    table.caption_justify = "left"
    return table
