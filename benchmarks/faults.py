"""Random flights with one or two random faults each; a monitor must find no violation.

    python benchmarks/faults.py --flights 10000 --jobs 2
    python benchmarks/faults.py --seed 4711                   one flight, with all its events
    python benchmarks/faults.py --seed 4711 --only-fault 1    the same flight without the other fault

docs/campaign.md has the rules of the monitor. The flights use the real firmware, compiled for this machine.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import multiprocessing
import re
import sys
import time
import traceback
from collections import Counter, defaultdict
from collections.abc import Iterable
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "tests"))

from faults_script import Outcome, Script, draw, fly
from invariant_monitor import Violation

from flying_vines.simulation.phlosar.core_library import load

LAST_S = 8.0
"""Part of a timeline that is printed before a violation."""


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--flights", type=int, default=200, help="number of flights, one seed each")
    parser.add_argument("--first", type=int, default=1, help="seed of the first flight")
    parser.add_argument("--jobs", type=int, default=1, help="number of processes")
    parser.add_argument("--minutes", type=float, default=math.inf, help="maximum time")
    parser.add_argument("--seed", type=int, help="fly only the flight of this seed and print its timeline")
    parser.add_argument("--only-fault", type=int, choices=(1, 2), help="with --seed: without the other fault")
    args = parser.parse_args()
    load()  # Build once, before several processes need it.
    if args.seed is not None:
        return _one(args.seed, args.only_fault)
    return _many(range(args.first, args.first + args.flights), args.jobs, args.minutes)


def _one(seed: int, only_fault: int | None) -> int:
    script = draw(seed)
    if only_fault is not None:
        if only_fault > len(script.faults):
            sys.exit(f"flight {seed} has only one fault")
        script = dataclasses.replace(script, faults=(script.faults[only_fault - 1],))
    print(script.setup)
    outcome = fly(script)
    _print_timeline(outcome.timeline)
    print(f"highest pressure {outcome.highest_kPa:.1f} kPa; began to move {outcome.begins} times")
    for violation in outcome.violations:
        print(f"VIOLATION {violation}")
    return 1 if outcome.violations else 0


def _fly_safely(seed: int) -> Outcome:
    """Fly one flight. An exception is a violation."""
    script = draw(seed)
    try:
        return fly(script)
    except Exception:
        violation = Violation(0.0, "crash", traceback.format_exc())
        names = tuple(fault.name for fault in script.faults)
        return Outcome(
            seed, names, (False,) * len(names), ("",) * len(names), (violation,), 0, 0, 0.0, 0.0, ()
        )


def _many(seeds: Iterable[int], jobs: int, most_minutes: float) -> int:
    began_s = time.monotonic()
    tally = Tally()
    with multiprocessing.Pool(jobs) as pool:
        for outcome in pool.imap_unordered(_fly_safely, seeds, chunksize=4):
            tally.take(outcome)
            if outcome.violations:
                _print_violation(outcome)
            if time.monotonic() - began_s > 60.0 * most_minutes:
                break
    tally.print((time.monotonic() - began_s) / 60.0)
    return 1 if tally.violations else 0


class Tally:
    """The results of all flights."""

    def __init__(self) -> None:
        self.flights = self.singles = self.begins = self.limits = 0
        self.violations: Counter[str] = Counter()
        self.seeds: list[tuple[int, tuple[str, ...], tuple[str, ...]]] = []
        self._drawn: Counter[str] = Counter()
        self._pairs: Counter[tuple[str, ...]] = Counter()
        self._alone: Counter[str] = Counter()
        self._bent: Counter[str] = Counter()
        self._told: dict[str, Counter[str]] = defaultdict(Counter)
        self._highest: dict[str, float] = defaultdict(float)
        self._blind: dict[str, float] = defaultdict(float)

    def take(self, outcome: Outcome) -> None:
        self.flights += 1
        self.begins += outcome.begins
        self.limits += outcome.limits
        self.violations.update(violation.rule for violation in outcome.violations)
        if outcome.violations:
            self.seeds.append(
                (outcome.seed, outcome.faults, tuple(violation.rule for violation in outcome.violations))
            )
        self._drawn.update(outcome.faults)
        self._pairs.update([tuple(sorted(outcome.faults))] if len(outcome.faults) > 1 else [])
        if len(outcome.faults) > 1:
            return
        # Only flights with one fault: of two faults, it is unknown which one the text reports.
        self.singles += 1
        (name,) = outcome.faults
        self._alone[name] += 1
        self._highest[name] = max(self._highest[name], outcome.highest_kPa)
        self._blind[name] = max(self._blind[name], outcome.longest_blind_s)
        if outcome.bent[0]:
            self._bent[name] += 1
            self._told[name][re.sub(r"-?\d+(\.\d+)?", "#", outcome.texts[0])] += 1

    def print(self, minutes: float) -> None:
        print(
            f"\n{self.flights} flights, {self.singles} of them with one fault; "
            f"the vine began to move {self.begins} times, {self.limits} of them by an event that looks like "
            f"a request of the pilot; {minutes:.1f} min"
        )
        print(f"violations: {dict(self.violations) or 'none'}")
        for seed, faults, rules in sorted(self.seeds):
            print(f"  seed {seed}: {', '.join(faults)}: {', '.join(rules)}")
        print()
        print(
            f"{len(self._pairs)} different pairs. In each row, only the first number includes flights with "
            "two faults:\n"
        )
        print("| fault | flights | alone | bent | text within 5 s | highest, kPa | the pilot's first text |")
        print("| --- | ---: | ---: | ---: | ---: | ---: | --- |")
        for name in sorted(self._drawn):
            told = self._told[name]
            first = [f"{text} ({n})" for text, n in told.most_common(4) if text][:3]
            bent = self._bent[name]
            print(
                f"| {name} | {self._drawn[name]} | {self._alone[name]} | {bent} | {bent - told['']} "
                f"| {self._highest[name]:.0f} | {'; '.join(first) or '–'} |"
            )
        blind = {name: round(s, 2) for name, s in self._blind.items() if s > 0.05}
        print(f"\nLongest time of inflating above the firmware's limit, s: {blind or 'never'}")


def _print_violation(outcome: Outcome) -> None:
    script = draw(outcome.seed)
    print(f"\nseed {outcome.seed}, {script.setup.autopilot}:")
    _print_faults(script)
    first_s = min(violation.t for violation in outcome.violations)
    _print_timeline([(t, text) for t, text in outcome.timeline if first_s - LAST_S <= t <= first_s + 1.0])
    for violation in outcome.violations:
        print(f"VIOLATION {violation}", flush=True)


def _print_faults(script: Script) -> None:
    for number, fault in enumerate(script.faults, start=1):
        print(f"  fault {number} at {fault}")


def _print_timeline(timeline: Iterable[tuple[float, str]]) -> None:
    for t, text in sorted(timeline, key=lambda line: line[0]):
        print(f"  {t:7.3f}  {text}")


if __name__ == "__main__":
    sys.exit(main())
