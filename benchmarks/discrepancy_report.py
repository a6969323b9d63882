"""The tables of the benchmark of `diagnose`, from its outcomes."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from statistics import fmean, median

from discrepancy_outcome import DIAGNOSE, Outcome
from discrepancy_scores import (
    AT_NOISE,
    CONFIDENT,
    LARGE,
    NEAR,
    NEAR_NOISE,
    SEVERAL,
    Judgement,
    Neutral,
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
STRONG = ("clear", "subtle")
"""Tiers whose parameters must be near the truth."""
PAIR = "pair"
SEVERAL_GOALS = ("≥ 80 %", "≥ 70 %", "≤ 5 %", "≥ 70 %", "90–98 %", "", "≤ 60 s")
"""Goals for several effects, in the order of the columns of `several_table`."""
KINDS = ("a cause", NONE, UNEXPLAINED)


def show(outcomes: Sequence[Outcome], console: Console) -> None:
    """Print all tables."""
    ours = [outcome for outcome in outcomes if outcome.by == DIAGNOSE]
    engines = sorted({outcome.engine for outcome in outcomes})
    if len(engines) > 1:
        console.print(f"These are outcomes of {len(engines)} versions of the sources: {', '.join(engines)}")
    if ours:
        parts = [("Named", tiers_table(ours)), ("Parameters of rightly named causes", measured_table(ours))]
        if any(outcome.truth.tier in SEVERAL for outcome in ours):
            parts.append(("Several effects at once", several_table(ours)))
        if wrong := wrong_table(ours):
            parts.append(("Wrong verdicts", wrong))
        parts += [("Confidence", confidence_table(ours)), ("Cost", cost_table(ours))]
        for title, table in parts:
            console.print(f"\n{title}\n")
            console.print(table)
        console.print()
        for line in (*accusations(ours), *fresh_lines(ours)):
            console.print(line)
    if peers := sorted({outcome.by for outcome in outcomes} - {DIAGNOSE}):
        console.print("\nOther methods, on the cases that all have diagnosed\n")
        console.print(peers_table(outcomes, [DIAGNOSE, *peers] if ours else peers))
    for outcome in outcomes:
        if outcome.error:
            tier, seed = outcome.truth.tier, outcome.truth.seed
            console.print(f"failed: {outcome.by} on {tier} {seed}: {outcome.error}")


def tiers_table(outcomes: Sequence[Outcome]) -> Table:
    """The number of right cases, by tier."""
    table = _table("tier", "counted", "share", "95 %", "goal", "right", "alike", "left open", "false extra")
    for tier, group in _by_tier(outcomes):
        counted = sum(counts(outcome) for outcome in group)
        judged = Counter(judgement(outcome) for outcome in group)
        extra = [o for o in group if o.said and any(one.cause not in o.truth.hidden for one in o.said.also)]
        table.add_row(
            tier,
            f"{counted}/{len(group)}",
            f"{counted / len(group):.1%}",
            _interval(counted, len(group)),
            f"{GOALS[tier]:.0%}",
            str(judged[Judgement.RIGHT]),
            str(judged[Judgement.ALIKE]),
            str(judged[Judgement.OPEN]),
            str(len(extra)),
        )
    return table


def measured_table(outcomes: Sequence[Outcome]) -> Table:
    """Parameters of rightly named causes, and errors on unseen data."""
    neutral = neutral_values()
    near = f"within {NEAR:.0%}"
    table = _table("tier", "parameters", near, "95 %", "median off", "interval holds", "95 %", "at noise")
    strong = [outcome for outcome in outcomes if outcome.truth.tier in STRONG]
    for tier, group in (*_by_tier(outcomes), (" + ".join(STRONG), strong), ("all", outcomes)):
        said = [(o.truth, o.said) for o in group if o.said is not None]
        found = [one for truth, verdict in said for one in measured(truth, verdict)]
        ratios = [ratio for truth, verdict in said if (ratio := over_noise(verdict)) is not None]
        quiet = sum(ratio <= AT_NOISE for ratio in ratios)
        errors = [off(one, neutral) for one in found]
        close = sum(error <= NEAR for error in errors)
        held = sum(one.held for one in found)
        known = (
            str(len(found)),
            _share(close, len(found)),
            _interval(close, len(found)),
            f"{median(errors):.2%}" if errors else "",
            _share(held, len(found)),
            _interval(held, len(found)),
        )
        table.add_row(tier, *known, f"{quiet}/{len(ratios)}")
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


def cost_table(outcomes: Sequence[Outcome]) -> Table:
    """Time of a case, by tier."""
    table = _table("tier", "CPU median", "90 %", "most", "wall median", "90 %", "most")
    for tier, group in (*_by_tier(outcomes), ("all", outcomes)):
        cpu_s = sorted(o.cpu_s for o in group if o.cpu_s is not None)
        wall_s = sorted(o.wall_s for o in group if o.wall_s is not None)
        if cpu_s:
            cells = [f"{value:.1f} s" for times in (cpu_s, wall_s) for value in _spread(times)]
            table.add_row(tier, *cells)
    return table


def _spread(rising: Sequence[float]) -> tuple[float, float, float]:
    return median(rising), rising[int(0.9 * (len(rising) - 1))], rising[-1]


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


def fresh_lines(outcomes: Sequence[Outcome]) -> Iterator[str]:
    """A line about the cost of the command in a process of its own."""
    fresh = [outcome.fresh for outcome in outcomes if outcome.fresh is not None]
    if fresh:
        cpu_s, wall_s = median(one.cpu_s for one in fresh), median(one.wall_s for one in fresh)
        peak_MB = max(one.peak_MB for one in fresh)
        yield (
            f"The command in a fresh process ({len(fresh)} cases): CPU {cpu_s:.1f} s, wall {wall_s:.1f} s in "
            f"the median, peak memory {peak_MB:.0f} MB at most"
        )


def peers_table(outcomes: Sequence[Outcome], everyone: Sequence[str]) -> Table:
    """The comparison of all methods on the same cases."""
    by: dict[str, dict[tuple[str, int], Outcome]] = {name: {} for name in everyone}
    for outcome in outcomes:
        by[outcome.by][outcome.truth.tier, outcome.truth.seed] = outcome
    shared = set.intersection(*(set(cases) for cases in by.values()))
    table = _table("", *everyone)
    rows: dict[str, list[str]] = defaultdict(list)
    for name in everyone:
        for title, cell in _answers([by[name][key] for key in sorted(shared)]).items():
            rows[title].append(cell)
    for title, cells in rows.items():
        table.add_row(title, *cells)
    return table


def _answers(outcomes: Sequence[Outcome]) -> dict[str, str]:
    """One column of the comparison."""
    said = [(outcome.truth, outcome.said) for outcome in outcomes if outcome.said is not None]
    hiding = [(truth, verdict) for truth, verdict in said if truth.hidden]
    known = [(truth, verdict) for truth, verdict in hiding if not truth.outside]
    nameable = [o for o in outcomes if o.truth.hidden and not o.truth.outside]
    answers = {
        f"{tier}: the cause (or both) right": _of(sum(_named(o) for o in group), len(group))
        for tier, group in _by_tier(nameable)
    }
    clean = [verdict for truth, verdict in said if not truth.hidden]
    outside = [verdict for truth, verdict in said if truth.outside]
    ratios = [ratio for _, verdict in said if (ratio := over_noise(verdict)) is not None]
    cpu_s = [outcome.cpu_s for outcome in outcomes if outcome.cpu_s is not None]
    return answers | {
        "something hidden, and not `none`": _of(sum(v.cause != NONE for _, v in hiding), len(hiding)),
        "nothing hidden, and not `none`": _of(sum(v.cause != NONE for v in clean), len(clean)),
        "wrong names per case, without effects outside the catalogue": _mean(
            len(false_names(t, v)) for t, v in known
        ),
        "outside the catalogue, and a cause named": _of(sum(bool(v.named) for v in outside), len(outside)),
        "error on unseen data over noise, median": f"{median(ratios):.2f}" if ratios else "–",
        "CPU seconds per case, median": f"{median(cpu_s):.1f}" if cpu_s else "–",
        "failed": str(len(outcomes) - len(said)),
    }


def _named(outcome: Outcome) -> bool:
    """True if the hidden causes are named, or are among the indistinguishable ones."""
    return judgement(outcome) in (Judgement.RIGHT, Judgement.ALIKE)


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


def _mean(values: Iterable[int]) -> str:
    numbers = list(values)
    return f"{fmean(numbers):.2f}" if numbers else "–"
