"""Which mishaps the physics checks find, how quickly, and if they are silent on healthy rigs.

    .venv/bin/python benchmarks/physics_checks.py [--rigs N] [--mishaps N] [--first SEED] [--jobs N] [--check]

First it flies random healthy rigs, whose assumed numbers are wrong, with the firmware's regulator: every
finding is a false one. Then it injects each mishap into many random rigs, at a random moment of the flight,
and reports what finds it first: a check, or the limits of firmware and service. `physics_checks_rigs.py`
draws the rigs. Needs numba: pip install 'flying-vines[analysis]'.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from statistics import median
from typing import TypeVar

from physics_checks_flights import MISHAPS, Noticed, fly
from physics_checks_rigs import drawn, telemetry_of
from rich.console import Console

from flying_vines.config.config import ChecksConfig
from flying_vines.supply import TelemetryReader, nominal
from flying_vines.supply.physics_checks import CHECKS, PhysicsChecks

T = TypeVar("T")
HEALTHY_S = 90.0
CHECKS_CONFIG = ChecksConfig()
MOST_WARNED = 1 / 200
"""Maximum share of healthy rigs with a warning."""


@dataclass(frozen=True)
class Healthy:
    """The flight of a healthy rig."""

    seed: int
    flown_s: float
    findings: tuple[str, ...]
    """Each finding as `name: sentence`, when it began."""


def judge(seed: int) -> Healthy:
    """Fly one healthy rig."""
    case = drawn(seed)
    prior = nominal(case.believed)
    reader, checks = TelemetryReader(prior), PhysicsChecks(prior, CHECKS_CONFIG)
    found: list[str] = []
    at_ms = 0
    for telemetry in telemetry_of(case, HEALTHY_S):
        at_ms = telemetry.device_time_ms
        begun = checks.take(reader.read(at_ms / 1000.0, telemetry))
        found += [f"{f.name} after {at_ms / 1000:.2f} s: {f.sentence}" for f in begun]
    return Healthy(seed, at_ms / 1000.0, tuple(found))


def healthy(seeds: range, jobs: int, console: Console) -> list[str]:
    """Fly healthy rigs. Returns the missed goals."""
    faults, warnings, flown_s = Counter[str](), Counter[str](), 0.0
    for rig in mapped(judge, seeds, jobs):
        flown_s += rig.flown_s
        for line in rig.findings:
            console.print(f"  rig {rig.seed}: {line}")
        for name in {line.split()[0] for line in rig.findings}:
            (faults if getattr(CHECKS_CONFIG, name) == "fault" else warnings)[name] += 1
    console.print(
        f"{len(seeds)} healthy rigs from seed {seeds.start} on, {flown_s / 3600.0:.1f} h of flying: "
        f"{faults.total()} false faults {dict(faults)}, {warnings.total()} false warnings {dict(warnings)}"
    )
    missed = [f"{n} healthy rigs with a false fault '{name}'" for name, n in faults.items()]
    if warnings.total() > MOST_WARNED * len(seeds):
        missed.append(f"{warnings.total()} of {len(seeds)} healthy rigs with a warning")
    return missed


def mapped(made_of: Callable[[int], T], seeds: Sequence[int], jobs: int) -> Iterator[T]:
    """The result of each seed, in order."""
    if jobs == 1:
        yield from map(made_of, seeds)
        return
    with ProcessPoolExecutor(jobs) as pool:
        yield from pool.map(made_of, seeds)


def mishaps(seeds: range, jobs: int, console: Console) -> None:
    """Print a line for each mishap as soon as it is finished."""
    console.print("| mishap | noticed | by | median s | most s | vine's true peak, kPa: median, most |")
    console.print("| --- | --- | --- | --- | --- | --- |")
    for name in MISHAPS:
        found: list[Noticed] = list(mapped(partial(fly, name), seeds, jobs))
        noticed = [n for n in found if n.by]
        by = ", ".join(f"{by} {n}" for by, n in Counter(n.by for n in noticed).most_common())
        times_s = [n.after_s for n in noticed]
        times = f"{median(times_s):.2f} | {max(times_s):.2f}" if times_s else "- | -"
        peaks = f"{median(n.peak_kPa for n in found):.0f}, {max(n.peak_kPa for n in found):.0f}"
        console.print(f"| {name} | {len(noticed)} of {len(found)} | {by} | {times} | {peaks} |")


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rigs", type=int, default=300, help="number of healthy rigs")
    parser.add_argument("--mishaps", type=int, default=30, help="rigs for each mishap")
    parser.add_argument("--first", type=int, default=1, help="the first rig's seed")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument(
        "--check",
        action="store_true",
        help="exit status 1 if a healthy rig has a fault, or many are warned",
    )
    arguments = parser.parse_args()
    if min(arguments.rigs, arguments.mishaps) < 0 or arguments.jobs < 1:
        parser.error("--rigs and --mishaps must not be below 0, --jobs not below 1")
    console = Console(highlight=False, soft_wrap=True, width=140)
    console.print(f"checks: {', '.join(CHECKS)}")
    missed: list[str] = []
    if arguments.rigs:
        seeds = range(arguments.first, arguments.first + arguments.rigs)
        missed = healthy(seeds, arguments.jobs, console)
    if arguments.mishaps:
        mishaps(range(arguments.first, arguments.first + arguments.mishaps), arguments.jobs, console)
    for line in missed:
        console.print(f"missed: {line}")
    return 1 if missed and arguments.check else 0


if __name__ == "__main__":
    sys.exit(main())
