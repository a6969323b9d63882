"""Error of the cycles left: random rigs, unknown to the estimate, fly until the reservoir is empty.

    .venv/bin/python benchmarks/cycles_left.py [--rigs N] [--first SEED] [--jobs N] [--each] [--check]

Every rig is the high-fidelity plant under the firmware's regulator; the estimate sees only its telemetry.
After 5 cycles, after 15 and half way the estimate predicts the cycles left. The truth is the number of cycles
that the rig then flies; a smaller swing counts as part of a cycle. The paper's formula (Eq. 8) predicts with
the same assumed numbers at the same pressure. `cycles_left_rigs.py` draws the rigs, and
`cycles_left_flights.py` defines the end of a flight. Needs numba: pip install 'flying-vines[analysis]'.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import count, islice
from statistics import fmean, median

from cycles_left_flights import FEWEST_CYCLES, began, fly, telemetry_messages
from cycles_left_rigs import draw
from rich.console import Console
from rich.table import Table

from flying_vines.config.config import PneumaticsConfig
from flying_vines.physics import paper
from flying_vines.supply import CyclesLeft, ReservoirEstimate, TelemetryReader, nominal

MOMENTS = ("after 5 cycles", "after 15 cycles", "half way")
GOALS = {"after 5 cycles": 0.15, "after 15 cycles": 0.07}
"""Maximum relative error of the median rig."""
MOST_WITHIN = {"after 5 cycles": 0.9}
"""Minimum share of rigs whose error is within the goal."""
HELD = 0.85
"""Minimum share of rigs whose truth is in the 90 % interval."""


@dataclass(frozen=True)
class Guess:
    """The prediction at one moment, and the truth."""

    truth: float
    estimate: CyclesLeft
    formula: float

    @property
    def error(self) -> float:
        return self.estimate.expected / self.truth - 1.0

    @property
    def formula_error(self) -> float:
        return self.formula / self.truth - 1.0

    @property
    def held(self) -> bool:
        return self.estimate.low <= self.truth <= self.estimate.high


def by_paper(p: PneumaticsConfig, reservoir_kPa: float) -> float:
    """Cycles left by the paper's Eq. 8, for gauge reservoir pressure; not below 0."""
    cycles = paper.n_cycles(
        reservoir_kPa,
        reservoir_volume_L=p.reservoir_volume_L,
        cv_volume_L=p.cv_volume_L,
        swing_kPa=p.cycle_swing_kPa,
        rate_kPa_per_s=p.cycle_rate_kPa_per_s,
        flow_resistance_kPa_s_per_SL=p.evp_flow_resistance_kPa_s_per_SL,
    )
    return max(0.0, cycles)


def quantity(guesses: Sequence[Guess], errors: Sequence[float]) -> list[str]:
    """The numbers of one row: errors relative to the truth."""
    sizes = [abs(error) for error in errors]
    return [
        str(len(guesses)),
        f"{median(sizes):.1%}",
        f"{median(errors):+.1%}",
        f"{fmean(size <= 0.15 for size in sizes):.1%}",
        f"{fmean(size <= 0.07 for size in sizes):.1%}",
    ]


@dataclass(frozen=True)
class Outcome:
    """The result of one rig."""

    seed: int
    kind: str
    total_cycles: float
    guesses: tuple[Guess, ...]


def judge(seed: int) -> Outcome | None:
    """Fly one rig from filling to the end. None if it gives too few cycles, or if the flight is too long."""
    case = draw(seed)
    flight = fly(case)
    if flight is None or flight.total_cycles < FEWEST_CYCLES:
        return None
    reader, estimate = TelemetryReader(nominal(case.believed)), ReservoirEstimate(nominal(case.believed))
    guesses: list[Guess] = []
    moments = [began(flight, cycles) for cycles in (5.0, 15.0, 0.5 * flight.total_cycles)]
    for t, telemetry in telemetry_messages(flight.telemetry):
        estimate.update(reader.read(t, telemetry))
        # Two moments can come at once: half of 30 cycles is 15.
        for index in moments[len(guesses) :]:
            if t < flight.begins_s[index]:
                break
            said = estimate.cycles_left()
            assert said is not None
            truth = flight.total_cycles - float(flight.cycles[index])
            guesses.append(Guess(truth, said, by_paper(case.believed, estimate.reservoir_kPa)))
        if len(guesses) == len(moments):
            break
    return Outcome(seed, case.kind, flight.total_cycles, tuple(guesses))


def outcomes(first: int, rigs: int, jobs: int) -> Iterator[Outcome]:
    """The results of this many rigs. Rigs with too few cycles are skipped."""
    if jobs == 1:
        yield from islice(filter(None, map(judge, count(first))), rigs)
        return
    with ProcessPoolExecutor(jobs) as pool:
        # Submit in portions, because the number of skipped rigs is unknown.
        found, seed = 0, first
        while found < rigs:
            batch = range(seed, seed + max(jobs, rigs - found))
            for outcome in filter(None, pool.map(judge, batch)):
                found += 1
                yield outcome
                if found == rigs:
                    return
            seed = batch.stop


def table_of(found: Sequence[Outcome]) -> Table:
    table = Table("", "by", "rigs", "median error", "signed", "within 15 %", "within 7 %", "interval holds")
    for index, moment in enumerate(MOMENTS):
        kinds = sorted({outcome.kind for outcome in found})
        groups = [("estimate", found), *((f"  {k}", [o for o in found if o.kind == k]) for k in kinds)]
        for name, group in groups:
            guesses = [outcome.guesses[index] for outcome in group]
            numbers = quantity(guesses, [guess.error for guess in guesses])
            table.add_row(moment, name, *numbers, f"{fmean(guess.held for guess in guesses):.1%}")
        guesses = [outcome.guesses[index] for outcome in found]
        numbers = quantity(guesses, [guess.formula_error for guess in guesses])
        table.add_row(moment, "paper's Eq. 8", *numbers, "", end_section=True)
    return table


def missed_goals(found: Sequence[Outcome]) -> list[str]:
    """One line for each missed goal."""
    missed = []
    for index, moment in enumerate(MOMENTS):
        guesses = [outcome.guesses[index] for outcome in found]
        goal = GOALS.get(moment, math.inf)
        error = median(abs(guess.error) for guess in guesses)
        if error > goal:
            missed.append(f"{moment} the median error is {error:.1%}, the goal {goal:.0%}")
        share = fmean(abs(guess.error) <= goal for guess in guesses)
        if share < MOST_WITHIN.get(moment, 0.0):
            missed.append(f"{moment} {share:.1%} are within {goal:.0%}, the goal {MOST_WITHIN[moment]:.0%}")
        held = fmean(guess.held for guess in guesses)
        if held < HELD:
            missed.append(
                f"{moment} the interval contains the truth in {held:.1%} of the rigs, the goal {HELD:.0%}"
            )
    return missed


def tell(outcome: Outcome) -> str:
    """One line for a rig."""
    said = (
        f"{g.truth:6.1f}: {g.estimate.expected:6.1f} ({g.estimate.low:.1f} to {g.estimate.high:.1f})"
        f" {g.error:+7.1%}, Eq. 8 {g.formula:7.1f}"
        for g in outcome.guesses
    )
    return f"{outcome.seed:6d} {outcome.kind:9s} " + " | ".join(said)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rigs", type=int, default=200)
    parser.add_argument("--first", type=int, default=40_000, help="the first rig's seed")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--each", action="store_true", help="also a line for every rig")
    parser.add_argument("--check", action="store_true", help="exit status 1 if a goal is missed")
    arguments = parser.parse_args()
    if min(arguments.rigs, arguments.jobs) < 1:
        parser.error("--rigs and --jobs must not be below 1")
    console = Console(highlight=False, soft_wrap=True, width=120)
    found: list[Outcome] = []
    for outcome in outcomes(arguments.first, arguments.rigs, arguments.jobs):
        found.append(outcome)
        if arguments.each:
            console.print(tell(outcome))
    tried = found[-1].seed - arguments.first + 1
    totals = [outcome.total_cycles for outcome in found]
    console.print(
        f"{len(found)} rigs of {tried} from seed {arguments.first} on: the others give fewer than "
        f"{FEWEST_CYCLES:g} cycles, or fly too long. A filling gives {min(totals):.0f} to "
        f"{max(totals):.0f} cycles, in the median {median(totals):.0f}."
    )
    console.print(table_of(found))
    missed = missed_goals(found)
    for line in missed:
        console.print(f"missed: {line}")
    return 1 if missed and arguments.check else 0


if __name__ == "__main__":
    sys.exit(main())
