"""How often `flying-vines diagnose` is right about rigs with hidden effects, compared with other methods.

    python benchmarks/discrepancy.py --cases 100 --results results.jsonl    # continues an interrupted run
    python benchmarks/discrepancy.py --cases 12 --tiers clear,null --peers --results results.jsonl
    python benchmarks/discrepancy.py --report results.jsonl

`tests/hidden_truth` draws the cases: a simulator that shares no code with this project. Its `draw.py` defines
the tiers, `discrepancy_scores.py` the scores. Each outcome is a line of the results file, and the tables use
only this file. Needs pip install 'flying-vines[analysis]', and with --peers pip install
'flying-vines[benchmarks]' (pysindy, scikit-learn).
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from discrepancy_outcome import Outcome, ResultsError, append, as_outcome, begun, read_outcomes
from discrepancy_report import GOALS, show
from discrepancy_scores import judgement
from rich.console import Console

BAD_INPUT = 2
FIRST_SEED = 50_000
"""Cases that no test uses, and on which nothing was tuned."""
TIERS = tuple(GOALS)


def main(argv: Sequence[str] | None = None) -> int:
    parser = _parser()
    arguments = parser.parse_args(argv)
    console = Console(highlight=False, soft_wrap=True, width=160)
    try:
        outcomes = _run(arguments) if arguments.report is None else read_outcomes(arguments.report)
    except ResultsError as error:
        parser.exit(BAD_INPUT, f"{parser.prog}: {error}\n")
    except ModuleNotFoundError as error:
        extra = "benchmarks" if error.name in ("pysindy", "sklearn") else "analysis"
        parser.exit(
            BAD_INPUT,
            f"{parser.prog}: {error.name} is missing: pip install 'flying-vines[{extra}]'\n",
        )
    except KeyboardInterrupt:
        return 130
    show(outcomes, console)
    return 0


def _run(arguments: argparse.Namespace) -> list[Outcome]:
    """All outcomes: those in the file, and the missing ones, which are computed."""
    # Imported here, because a report does not need the workers and peers.
    import discrepancy_cases
    import discrepancy_peers

    if arguments.peers:
        discrepancy_peers.require()
    results: Path | None = arguments.results
    found = begun(results) if results is not None else []
    seeds = range(arguments.seed, arguments.seed + arguments.cases)
    every = list(discrepancy_cases.jobs(arguments.peers, arguments.tiers, seeds))
    known = {outcome.key for outcome in found}
    missing = [job for job in every if job.key not in known]
    for done, row in enumerate(discrepancy_cases.outcomes(missing, arguments.workers), start=1):
        outcome = as_outcome(row)
        found.append(outcome)
        if results is not None:
            append(results, row)
        print(f"{done}/{len(missing)} {_line(outcome)}", file=sys.stderr, flush=True)
    asked = {job.key for job in every}
    return [outcome for outcome in found if outcome.key in asked]


def _line(outcome: Outcome) -> str:
    """One line for an outcome, printed during the run."""
    truth, said = outcome.truth, outcome.said
    hidden = " + ".join(truth.hidden) or "none"
    answer = outcome.error if said is None else " + ".join(said.named) or said.cause
    return f"{outcome.by}: {truth.tier} {truth.seed}: {hidden}: {answer}: {judgement(outcome).value}"


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
    parser.add_argument("--peers", action="store_true", help="also run other methods on the same cases")
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
