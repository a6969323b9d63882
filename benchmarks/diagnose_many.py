"""How much sooner a season of cases is diagnosed by several processes than by a plain loop.

    python benchmarks/diagnose_many.py [--cases 6] [--workers 1 2] [--rounds 2] [--cluster]

The same cases, of the independent simulator in `tests/hidden_truth`, go through a plain loop over
`diagnose(read_case(folder))`, which has one thread a core as always, and through `diagnose_all`.
What is printed is cases a minute, and times as many as the loop, of the quickest of some rounds; every way
must give the same verdicts. The time to start processes and to load what is compiled is in it.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from functools import partial
from math import inf
from pathlib import Path
from time import perf_counter

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from hidden_truth import draw, write

from flying_vines.identification.case import read_case
from flying_vines.identification.cores import cores
from flying_vines.identification.diagnose import diagnose
from flying_vines.identification.many import CaseOutcome, diagnose_all

TIER = "clear"
Way = Callable[[list[Path]], Iterable[tuple[Path, CaseOutcome]]]


def loop(folders: list[Path]) -> Iterable[tuple[Path, CaseOutcome]]:
    """What a user would write."""
    return [(folder, diagnose(read_case(folder))) for folder in folders]


def answers(outcomes: Iterable[tuple[Path, CaseOutcome]]) -> dict[str, str]:
    """By case, the verdict as text."""
    said: dict[str, str] = {}
    for path, outcome in outcomes:
        if isinstance(outcome, Exception):
            raise SystemExit(str(outcome))
        said[path.name] = json.dumps(outcome.as_json())
    return said


def measured(ways: dict[str, Way], folders: list[Path], rounds: int) -> dict[str, float]:
    """The least time of each way; all ways take turns, for other work on the machine comes and goes."""
    took_s = dict.fromkeys(ways, inf)
    expected: dict[str, str] = {}
    for _ in range(rounds):
        for name, way in ways.items():
            began_s = perf_counter()
            said = answers(way(folders))
            took_s[name] = min(took_s[name], perf_counter() - began_s)
            expected = expected or said
            if said != expected:
                raise SystemExit(f"{name}: other verdicts than the plain loop's")
    return took_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--cases", type=int, default=6)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--cluster", action="store_true", help="a Dask cluster on this machine as well")
    arguments = parser.parse_args()
    with ExitStack() as stack:
        parent = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        folders = [parent / f"{TIER}_{seed}" for seed in range(1, arguments.cases + 1)]
        for seed, folder in enumerate(folders, start=1):
            write(folder, draw(TIER, seed))
        ways: dict[str, Way] = {"plain loop": loop}
        for workers in arguments.workers:
            ways[f"diagnose_all, {workers} processes"] = partial(diagnose_all, workers=workers)
        if arguments.cluster:
            from distributed import LocalCluster

            cluster = stack.enter_context(
                LocalCluster(n_workers=cores(), threads_per_worker=1, dashboard_address=":0")
            )
            ways[f"Dask, {cores()} workers"] = partial(diagnose_all, scheduler=cluster.scheduler_address)
        loop(folders[:1])  # compiles what is not compiled yet
        print(f"{len(folders)} cases of the tier {TIER}, {cores()} cores\n")
        print(f"{'':32}{'cases a minute':>16}{'times the loop':>16}")
        took_s = measured(ways, folders, arguments.rounds)
        for name, seconds in took_s.items():
            ratio = took_s["plain loop"] / seconds
            print(f"{name:32}{60.0 * len(folders) / seconds:16.1f}{ratio:16.2f}")


if __name__ == "__main__":
    main()
