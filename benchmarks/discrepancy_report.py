"""The tables of the benchmark of `diagnose`, from its outcomes."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from statistics import fmean, median

from discrepancy_scores import (
    AT_NOISE,
    CONFIDENT,
    LARGE,
    NEAR,
    NEAR_NOISE,
    SEVERAL,
    Judgement,
    Neutral,
    Outcome,
    brier,
    counts,
    false_names,
    holds,
    judgement,
    large,
    measured,
    off,
    over_noise,
    reliability,
    share_errors,
    wilson,
)
from rich import box
from rich.console import Console
from rich.table import Table

from flying_vines.identification.verdict import NONE, UNEXPLAINED
from flying_vines.physics.effects import catalogue

GOALS = {
    "clear": 0.98,
    "subtle": 0.95,
    "faint": 0.85,
    "worn": 0.85,
    "holes": 0.95,
    "short": 0.80,
    "pair": 0.85,
    "null": 0.99,
    "outside": 0.98,
    "hard": 0.85,
    "several": 0.80,
    "several_outside": 0.80,
    "rounded": 0.85,
}
"""Required share of right cases, by tier. If the catalogue lacks everything that is hidden, `unexplained` is
right."""
PAIR = "pair"
SEVERAL_GOALS = ("≥ 80 %", "≥ 70 %", "≤ 5 %", "≥ 70 %", "90–98 %", "", "≤ 60 s")
"""Goals for several effects, in the order of the columns of `several_table`."""
KINDS = ("a cause", NONE, UNEXPLAINED)


def show(outcomes: Sequence[Outcome], console: Console) -> None:
    """Print all tables."""
    engines = sorted({outcome.engine for outcome in outcomes})
    if len(engines) > 1:
        console.print(f"These are outcomes of {len(engines)} versions of the sources: {', '.join(engines)}")
    parts: list[tuple[str, Table | None]] = [
        ("Verdicts, and parameters of named causes", tiers_table(outcomes))
    ]
    if any(outcome.truth.tier in SEVERAL for outcome in outcomes):
        parts.append(("Several effects at once", several_table(outcomes)))
    parts += [("Wrong verdicts", wrong_table(outcomes)), ("Confidence", confidence_table(outcomes))]
    for title, table in parts:
        if table is not None:
            console.print(f"\n{title}\n")
            console.print(table)
    console.print()
    for line in accusations(outcomes):
        console.print(line)
    for outcome in outcomes:
        if outcome.error:
            console.print(f"failed: {outcome.truth.tier} {outcome.truth.seed}: {outcome.error}")


def tiers_table(outcomes: Sequence[Outcome]) -> Table:
    """By tier: right cases, parameters of rightly named causes, errors on unseen data, and the cost."""
    neutral = neutral_values()
    verdicts = ("counted", "95 %", "goal", "right", "alike", "left open", "false extra")
    numbers = (f"within {NEAR:.0%}", "interval holds", "at noise", "CPU, median")
    table = _table("tier", *verdicts, *numbers)
    for tier, group in _by_tier(outcomes):
        counted = sum(counts(outcome) for outcome in group)
        judged = Counter(judgement(outcome) for outcome in group)
        said = [(o.truth, o.said) for o in group if o.said is not None]
        extra = [v for truth, v in said if any(one.cause not in truth.hidden for one in v.also)]
        found = [one for truth, verdict in said for one in measured(truth, verdict)]
        ratios = [ratio for _, verdict in said if (ratio := over_noise(verdict)) is not None]
        cpu_s = [o.cpu_s for o in group if o.cpu_s is not None]
        table.add_row(
            tier,
            f"{counted}/{len(group)}",
            _interval(counted, len(group)),
            f"{GOALS[tier]:.0%}",
            str(judged[Judgement.RIGHT]),
            str(judged[Judgement.ALIKE]),
            str(judged[Judgement.OPEN]),
            str(len(extra)),
            f"{sum(off(one, neutral) <= NEAR for one in found)}/{len(found)}",
            f"{sum(one.held for one in found)}/{len(found)}",
            f"{sum(ratio <= AT_NOISE for ratio in ratios)}/{len(ratios)}",
            f"{median(cpu_s):.0f} s" if cpu_s else "–",
        )
    return table


def several_table(outcomes: Sequence[Outcome]) -> Table:
    """Whether the largest cause is named first, the large ones are listed, and no wrong cause is named."""
    named = ("largest first", f"over {LARGE:.0%} listed", "false names", f"unseen ≤ {NEAR_NOISE:g} noise")
    table = _table("tier", "cases", *named, "interval holds", "share off, median", "CPU, most")
    for tier, group in _by_tier(outcomes):
        if tier not in SEVERAL:
            continue
        said = [(o.truth, o.said) for o in group if o.said is not None]
        first = sum(judgement(outcome) is Judgement.RIGHT for outcome in group)
        listed = [name in verdict.named for truth, verdict in said for name in large(truth)]
        false = sum(len(false_names(truth, verdict)) for truth, verdict in said)
        claims = sum(len(verdict.named) for _, verdict in said)
        ratios = [ratio for _, verdict in said if (ratio := over_noise(verdict)) is not None]
        held = [one.held for truth, verdict in said for one in measured(truth, verdict)]
        errors = [abs(error) for truth, verdict in said for error in share_errors(truth, verdict)]
        cpu_s = sorted(o.cpu_s for o in group if o.cpu_s is not None)
        table.add_row(
            tier,
            str(len(group)),
            _of(first, len(group)),
            _of(sum(listed), len(listed)),
            _of(false, claims),
            _of(sum(ratio <= NEAR_NOISE for ratio in ratios), len(ratios)),
            _of(sum(held), len(held)),
            f"{median(errors):.3f}" if errors else "–",
            f"{cpu_s[-1]:.0f} s" if cpu_s else "–",
        )
    table.add_row("goal", "", *SEVERAL_GOALS)
    return table


def wrong_table(outcomes: Sequence[Outcome]) -> Table | None:
    """Truth and verdict of the wrong cases; None if all were right."""
    rows: dict[str, Counter[str]] = defaultdict(Counter)
    seen: Counter[str] = Counter()
    for outcome in outcomes:
        truth = " + ".join(sorted(outcome.truth.hidden)) or NONE
        seen[truth] += 1
        if judgement(outcome) is not Judgement.RIGHT:
            rows[truth][_words(outcome)] += 1
    if not rows:
        return None
    table = _table("hidden", "cases", "not right", "said", words=(0, 3))
    for truth, said in sorted(rows.items(), key=lambda row: (-row[1].total(), row[0])):
        listed = ", ".join(f"{name} ×{n}" if n > 1 else name for name, n in said.most_common())
        table.add_row(truth, str(seen[truth]), str(said.total()), listed)
    total = sum(said.total() for said in rows.values())
    table.add_row("all", str(seen.total()), str(total), "")
    return table


def _words(outcome: Outcome) -> str:
    if outcome.said is None:
        return "failed"
    words = " + ".join(sorted(outcome.said.named)) or outcome.said.cause
    return f"{words} (alike)" if judgement(outcome) is Judgement.ALIKE else words


def confidence_table(outcomes: Sequence[Outcome]) -> Table:
    """Stated confidence and how often it was right."""
    table = _table("said", "confidence", "verdicts", "stated", "came true", "95 %", "Brier")
    for kind, stated in _stated(outcomes).items():
        for index, one in enumerate(reliability(stated)):
            table.add_row(
                kind if index == 0 else "",
                f"{one.low:.0%} to {one.high:.0%}",
                str(one.of),
                f"{one.stated:.1%}",
                _share(one.held, one.of),
                _interval(one.held, one.of),
                f"{brier(stated):.4f}" if index == 0 else "",
            )
    every = [pair for stated in _stated(outcomes).values() for pair in stated]
    if every:
        held = sum(true for _, true in every)
        mean = f"{fmean(p for p, _ in every):.1%}"
        total = (mean, _share(held, len(every)), _interval(held, len(every)), f"{brier(every):.4f}")
        table.add_row("all", "", str(len(every)), *total)
    return table


def _stated(outcomes: Iterable[Outcome]) -> dict[str, list[tuple[float, bool]]]:
    """Confidences and whether they were right, by verdict."""
    found: dict[str, list[tuple[float, bool]]] = {kind: [] for kind in KINDS}
    for outcome in outcomes:
        said = outcome.said
        if said is not None and said.confidence is not None:
            kind = said.cause if said.cause in KINDS else KINDS[0]
            found[kind].append((said.confidence, holds(outcome.truth, said)))
    return {kind: stated for kind, stated in found.items() if stated}


def accusations(outcomes: Sequence[Outcome]) -> Iterator[str]:
    """Lines that count named causes on rigs with no, unknown, one and two hidden causes."""
    clean = [o for o in outcomes if o.said and not o.truth.hidden]
    if clean:
        accused = sum(bool(o.said and o.said.named) for o in clean)
        yield f"Rigs without a hidden effect for which a cause was named: {_of(accused, len(clean))}"
    outside = [o.said for o in outcomes if o.said and o.truth.outside]
    if outside:
        named = sum(bool(said.named) and (said.confidence or 0.0) > CONFIDENT for said in outside)
        missed = sum(said.cause == NONE for said in outside)
        yield (
            f"Rigs with an effect that the catalogue lacks, for which a cause was named with more than "
            f"{CONFIDENT:.0%}: {_of(named, len(outside))}; with `none`: {_of(missed, len(outside))}"
        )
    single = [o for o in outcomes if o.said and not o.truth.outside and len(o.truth.hidden) == 1]
    if single:
        alone = sum(not o.said.also for o in single if o.said)
        yield f"Rigs with one hidden cause, for which no further cause was named: {_of(alone, len(single))}"
    several = [o for o in outcomes if o.said and o.truth.tier == PAIR]
    if several:
        either = sum(bool(set(o.said.named) & set(o.truth.hidden)) for o in several if o.said)
        yield f"Rigs with two hidden causes, of which at least one was named: {_of(either, len(several))}"


def neutral_values() -> Neutral:
    """The neutral values of all parameters of the catalogue."""
    return {(cause.name, p.name): p.neutral for cause in catalogue() for p in cause.parameters}


def _by_tier(outcomes: Iterable[Outcome]) -> list[tuple[str, list[Outcome]]]:
    """In the order of the goals."""
    groups: Mapping[str, list[Outcome]] = {tier: [] for tier in GOALS}
    for outcome in outcomes:
        groups[outcome.truth.tier].append(outcome)
    return [(tier, group) for tier, group in groups.items() if group]


def _table(*names: str, words: Sequence[int] = (0,)) -> Table:
    table = Table(box=box.MARKDOWN)
    for index, name in enumerate(names):
        table.add_column(name, justify="left" if index in words else "right")
    return table


def _share(count: int, of: int) -> str:
    return f"{count / of:.1%}" if of else ""


def _interval(count: int, of: int) -> str:
    low, high = wilson(count, of)
    return f"{low:.0%} … {high:.0%}" if of else ""


def _of(count: int, of: int) -> str:
    return f"{count}/{of} ({_interval(count, of)})" if of else "–"
