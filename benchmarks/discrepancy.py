"""How often `flying-vines diagnose` is right about rigs with hidden effects.

    python benchmarks/discrepancy.py --cases 100 --results results.jsonl    # continues an interrupted run
    python benchmarks/discrepancy.py --report results.jsonl

`tests/hidden_truth` draws the cases: a simulator that shares no code with this project. Its `draw.py` defines
the tiers, `discrepancy_scores.py` the scores. Each outcome is a line of the results file, and the tables use
only this file. Each worker process uses only its own share of the cores, so the cost of a case does not
depend on the number of workers. Needs pip install 'flying-vines[analysis]'.
"""

from __future__ import annotations

import argparse
import hashlib
import multiprocessing
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import cache
from multiprocessing.queues import Queue
from pathlib import Path
from typing import Any

from discrepancy_report import GOALS, show
from discrepancy_scores import Key, Outcome, ResultsError, append, as_outcome, begun, judgement, read_outcomes
from rich.console import Console

import flying_vines.identification
from flying_vines.identification.case import Case, read_case
from flying_vines.identification.diagnose import diagnose
from flying_vines.identification.fit import FitProblem
from flying_vines.identification.noise import SensorNoise

TESTS = Path(__file__).parents[1] / "tests"
sys.path.insert(0, str(TESTS))

from hidden_truth import draw, write  # noqa: E402

BAD_INPUT = 2
FIRST_SEED = 50_000
"""Cases that no test uses, and on which nothing was tuned."""
TIERS = tuple(GOALS)


def main(argv: Sequence[str] | None = None) -> int:
    parser = _parser()
    arguments = parser.parse_args(argv)
    try:
        outcomes = _run(arguments) if arguments.report is None else read_outcomes(arguments.report)
    except ResultsError as error:
        parser.exit(BAD_INPUT, f"{parser.prog}: {error}\n")
    except KeyboardInterrupt:
        return 130
    show(outcomes, Console(highlight=False, soft_wrap=True, width=200))
    return 0


def _run(arguments: argparse.Namespace) -> list[Outcome]:
    """All outcomes: those in the file, and the missing ones, which are computed."""
    results: Path | None = arguments.results
    found = begun(results) if results is not None else []
    seeds = range(arguments.seed, arguments.seed + arguments.cases)
    # Seed by seed, so that an interrupted run has about as many cases of every tier.
    every = [(tier, seed) for seed in seeds for tier in arguments.tiers]
    known = {outcome.key for outcome in found}
    missing = [key for key in every if key not in known]
    for done, row in enumerate(_outcomes(missing, arguments.workers), start=1):
        outcome = as_outcome(row)
        found.append(outcome)
        if results is not None:
            append(results, row)
        print(f"{done}/{len(missing)} {_line(outcome)}", file=sys.stderr, flush=True)
    return [outcome for outcome in found if outcome.key in every]


def _line(outcome: Outcome) -> str:
    """One line for an outcome, printed during the run."""
    truth, said = outcome.truth, outcome.said
    hidden = " + ".join(truth.hidden) or "none"
    answer = outcome.error if said is None else " + ".join(said.named) or said.cause
    return f"{truth.tier} {truth.seed}: {hidden}: {answer}: {judgement(outcome).value}"


def _outcomes(cases: Sequence[Key], workers: int) -> Iterator[dict[str, Any]]:
    """Rows for a results file, as they are finished."""
    context = multiprocessing.get_context("spawn")
    cores = sorted(os.sched_getaffinity(0))
    shares: Queue[list[int]] = context.Queue()
    for first in range(workers):
        shares.put(cores[first::workers])
    # The numerical libraries of a new process read these variables when they are loaded.
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    with ProcessPoolExecutor(workers, context, _take_cores, (shares,)) as pool:
        waiting = [pool.submit(_outcome, *case) for case in cases]
        try:
            for done in as_completed(waiting):
                yield done.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _take_cores(shares: Queue[list[int]]) -> None:
    os.sched_setaffinity(0, shares.get())


def _outcome(tier: str, seed: int) -> dict[str, Any]:
    """Run one case. An error becomes the case's outcome and does not stop the other cases."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "case"
        row: dict[str, Any] = {"engine": _engine(), "truth": write(path, draw(tier, seed)), "said": None}
        try:
            case = read_case(path)
            _compile(case)
            began_s = time.process_time()
            row["said"] = diagnose(case).as_json()
            row["cpu_s"] = time.process_time() - began_s
            as_outcome(row)
        except Exception as error:
            row |= {"said": None, "error": f"{type(error).__name__}: {error}"}
        return row


def _compile(case: Case) -> None:
    """Run a simulation once: it compiles the plant, or loads it from the cache."""
    problem = FitProblem(case, (SensorNoise(1.0), SensorNoise(1.0)))
    problem.residuals(problem.start())


@cache
def _engine() -> str:
    """A short digest of the sources that determine cases and verdicts."""
    digest = hashlib.sha256()
    for folder in (Path(flying_vines.identification.__file__).parent, TESTS / "hidden_truth"):
        for file in sorted(folder.rglob("*.py")):
            digest.update(file.read_bytes())
    return digest.hexdigest()[:8]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    cores = len(os.sched_getaffinity(0))
    parser.add_argument("--cases", type=_at_least_one, default=20, help="cases of each tier (20)")
    parser.add_argument("--tiers", type=_tiers, default=TIERS, help="tiers, separated by commas (all)")
    parser.add_argument("--seed", type=int, default=FIRST_SEED, help=f"the first seed ({FIRST_SEED})")
    parser.add_argument(
        "--workers",
        type=int,
        choices=range(1, cores + 1),
        default=cores,
        help=f"processes (one a core: {cores})",
    )
    parser.add_argument(
        "--results", type=Path, metavar="FILE", help="file of outcomes; those in it are skipped"
    )
    parser.add_argument("--report", type=Path, metavar="FILE", help="only print the tables of a results file")
    return parser


def _at_least_one(text: str) -> int:
    if not text.isdecimal() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of cases: give 1 or more")
    return int(text)


def _tiers(text: str) -> tuple[str, ...]:
    names = tuple(text.split(","))
    for name in names:
        if name not in TIERS:
            raise argparse.ArgumentTypeError(f"there is no tier {name!r}: there are {', '.join(TIERS)}")
    return names


if __name__ == "__main__":
    sys.exit(main())
