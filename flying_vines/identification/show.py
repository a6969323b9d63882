"""Verdicts on a terminal and in words: one in detail, or many in one line each. Formats their numbers."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Sequence
from math import floor, isfinite, log10
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn
from rich.table import Column, Table
from rich.text import Text

from flying_vines.identification.candidate import STRUCTURE
from flying_vines.identification.parallel_diagnosis import CaseOutcome
from flying_vines.identification.recording import CaseError
from flying_vines.identification.residuals import Pattern
from flying_vines.identification.verdict import NONE, UNEXPLAINED, ParameterEstimate, Verdict
from flying_vines.physics.effects import catalogue

RANKED = 8
"""Number of candidates that are printed."""
_CAPTION = (
    "evidence: natural logarithm, relative to the best; unseen: error on data that the fit has not seen"
)
FAILED = "no verdict"
_UNITS = {
    "_kPa2_s_per_SL": "kPa²·s/SL",
    "_SL_per_s_kPa": "SL/(s·kPa)",
    "_kPa_per_min": "kPa/min",
    "_SL_per_s": "SL/s",
    "_kPa_s_per_SL": "kPa·s/SL",
    "_kPa_per_s": "kPa/s",
    "_per_kPa": "1/kPa",
    "_kPa": "kPa",
    "_L": "L",
    "_s": "s",
}
"""Unit by the ending of a name. The first that fits counts, so `_kPa_per_s` stands before `_s`."""
_HUGE = 1e6
_RAISED = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
_CHANCE = 1.3
"""−log₁₀ of 1 in 20."""


def show(verdict: Verdict, console: Console) -> None:
    """Print the verdict in words, its numbers, and the best candidates."""
    facts = Table.grid(Column(style="bold"), Column(overflow="fold"), padding=(0, 2))
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
    left = verdict.remainder
    return text + (f" {_percent(left.share).capitalize()} of the error remains." if left else "")


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
    table = Table(
        Column("cause and parameters", overflow="fold"),
        *(Column(heading, justify="right") for heading in ("χ²/n", "unseen", "evidence")),
        box=None,
        padding=(0, 2, 0, 0),
        title="Candidates, the best first",
        title_justify="left",
        caption=_CAPTION,
        caption_justify="left",
    )
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
    return table


def show_all(
    outcomes: Iterable[tuple[Path, CaseOutcome]], total: int, as_json: bool, console: Console
) -> bool:
    """Print outcomes as they arrive. True if every case has a verdict."""
    seen: list[tuple[Path, CaseOutcome]] = []
    # A redirected output must not contain the progress bar.
    screen = console if console.is_terminal else Console(markup=False, stderr=True)
    bar = Progress(
        *(BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()),
        console=screen,
        transient=True,
        redirect_stdout=False,
        redirect_stderr=False,
        disable=not screen.is_terminal or (as_json and console.is_terminal),
    )
    with bar:
        for path, outcome in bar.track(outcomes, total=total):
            seen.append((path, outcome))
            if as_json:
                print(json.dumps(as_object(path, outcome), allow_nan=False), flush=True)
            else:
                console.print(line(path, outcome), highlight=False, soft_wrap=True)
    if not as_json:
        console.print(summary(seen))
    return not any(isinstance(outcome, CaseError) for _, outcome in seen)


def as_object(path: Path, outcome: CaseOutcome) -> dict[str, object]:
    """The verdict in the rig-data format with the path of the case; or `error` if there is no verdict."""
    if isinstance(outcome, CaseError):
        return {"case": str(path), "error": str(outcome)}
    return {"case": str(path), **outcome.as_json()}


def line(path: Path, outcome: CaseOutcome) -> Text:
    """One case in one line."""
    if isinstance(outcome, CaseError):
        error = str(outcome)
        return Text.assemble((f"{FAILED}  ", "bold red"), error if str(path) in error else f"{path}: {error}")
    style = {NONE: "green", UNEXPLAINED: "yellow"}.get(outcome.cause, "bold")
    text = Text.assemble(f"{path}  ", (_causes(outcome), style), f"  {outcome.confidence:.0%}")
    for name, value in outcome.parameters.items():
        text.append(f"  {name} {_estimate(value)}")
    if outcome.indistinguishable:
        text.append(f"  or {', '.join(outcome.indistinguishable)}")
    return text


def summary(outcomes: Sequence[tuple[Path, CaseOutcome]]) -> Table:
    """A table of the number of cases for each verdict."""
    counts = Counter(FAILED if isinstance(o, CaseError) else _causes(o) for _, o in outcomes)
    columns = "verdict", Column("cases", justify="right")
    table = Table(
        *columns, box=None, padding=(0, 2, 0, 0), title=f"{len(outcomes)} cases", title_justify="left"
    )
    for name, count in counts.most_common():
        table.add_row(name, str(count))
    return table


def _causes(verdict: Verdict) -> str:
    return " + ".join((verdict.cause, *(named.cause for named in verdict.also)))


def label_and_unit(name: str) -> tuple[str, str]:
    """Label and unit of a name: `volume_L` gives (volume, L)."""
    for ending, unit in _UNITS.items():
        if f"_{name}".endswith(ending):
            return f"_{name}".removesuffix(ending).replace("_", " ").strip() or "change", unit
    return name.replace("_", " "), ""


def labelled(name: str) -> str:
    """The label with its unit, for an axis."""
    label, unit = label_and_unit(name)
    return f"{label}, {unit}" if unit else label


def numbers(estimate: ParameterEstimate) -> tuple[str, str, str]:
    """The estimate and the ends of its interval, rounded to two digits of the interval's half width."""
    half = 0.5 * (estimate.high - estimate.low)
    values = (estimate.estimate, estimate.low, estimate.high)
    if max(map(abs, values)) >= _HUGE:
        first, low, high = map(_in_powers, values)
        return first, low, high
    form = f",.{max(0, 1 - floor(log10(half)))}f" if isfinite(half) and half > 0.0 else ".4g"
    first, low, high = (signed(format(value, form)) for value in values)
    return first, low, high


def _in_powers(value: float) -> str:
    """The number, with a power of ten if it is large."""
    if abs(value) < _HUGE:
        return rounded(value)
    mantissa, exponent = f"{value:.2e}".split("e+")
    return f"{signed(mantissa)}\N{NO-BREAK SPACE}×\N{NO-BREAK SPACE}10{str(int(exponent)).translate(_RAISED)}"


def chance(pattern: Pattern) -> str:
    """How often noise alone gives such a pattern, in words."""
    if pattern.log_p < _CHANCE:
        return "noise alone gives this"
    if pattern.log_p < STRUCTURE:
        return f"noise gives this once in {10.0**pattern.log_p:,.0f} cases"
    return "noise practically never gives this"


def signed(number: str) -> str:
    """The number with a minus sign instead of a hyphen."""
    return number.replace("-", "−")


def share(value: float) -> str:
    """Percent with three significant digits."""
    return f"{100.0 * value:.3g} %"


def rounded(value: float) -> str:
    """Three significant digits, and whole numbers from 100."""
    return signed(f"{value:,.0f}" if abs(value) >= 100.0 else f"{value:.3g}")
