"""Prints the verdicts of many cases, one line each, and how often each cause was named."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from flying_vines.identification.parallel_diagnosis import CaseOutcome
from flying_vines.identification.recording import CaseError
from flying_vines.identification.verdict import NONE, UNEXPLAINED, Verdict

FAILED = "no verdict"


def show_all(
    outcomes: Iterable[tuple[Path, CaseOutcome]], total: int, as_json: bool, console: Console
) -> bool:
    """Print outcomes as they arrive. True if every case has a verdict."""
    seen: list[tuple[Path, CaseOutcome]] = []
    # A redirected output must not contain the progress bar.
    screen = console if console.is_terminal else Console(markup=False, stderr=True)
    bar = Progress(
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
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
        text.append(f"  {name} {value.estimate:.4g} ({value.low:.4g} … {value.high:.4g})")
    if outcome.indistinguishable:
        text.append(f"  or {', '.join(outcome.indistinguishable)}")
    return text


def summary(outcomes: Sequence[tuple[Path, CaseOutcome]]) -> Table:
    """A table of the number of cases for each verdict."""
    counts = Counter(FAILED if isinstance(o, CaseError) else _causes(o) for _, o in outcomes)
    table = Table(box=None, padding=(0, 2, 0, 0), title=f"{len(outcomes)} cases", title_justify="left")
    table.add_column("verdict")
    table.add_column("cases", justify="right")
    for name, count in counts.most_common():
        table.add_row(name, str(count))
    return table


def _causes(verdict: Verdict) -> str:
    return " + ".join((verdict.cause, *(named.cause for named in verdict.also)))
