"""Runs many cases in worker processes: draws, writes and diagnoses them, and collects the outcomes.

Each worker uses only its own share of the cores, so the cost of a case does not depend on the number of
workers. The simulation is compiled before the time is measured.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import cache
from multiprocessing.queues import Queue
from pathlib import Path
from typing import Any, NamedTuple

import discrepancy_peers
from discrepancy_outcome import DIAGNOSE, Key, as_outcome

import flying_vines.identification
from flying_vines.identification.case import Case, read_case
from flying_vines.identification.diagnose import diagnose
from flying_vines.identification.fit import FitProblem
from flying_vines.identification.noise import SensorNoise

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests"))

from hidden_truth import draw, write  # noqa: E402

_FRESH = HERE / "discrepancy_fresh.py"
_SOURCES = (Path(flying_vines.identification.__file__).parent, HERE.parent / "tests" / "hidden_truth")


class Job(NamedTuple):
    """A case, the method that diagnoses it, and whether to run the command on it as well."""

    by: str
    tier: str
    seed: int
    fresh: bool

    @property
    def key(self) -> Key:
        return self.by, self.tier, self.seed


def jobs(peers: bool, tiers: Sequence[str], seeds: range) -> Iterator[Job]:
    """Seed by seed, so that an interrupted run has about as many cases of every tier."""
    everyone = (DIAGNOSE, *discrepancy_peers.PEERS) if peers else (DIAGNOSE,)
    for seed in seeds:
        for tier in tiers:
            for by in everyone:
                yield Job(by, tier, seed, by == DIAGNOSE and seed == seeds.start)


def outcomes(jobs: Sequence[Job], workers: int) -> Iterator[dict[str, Any]]:
    """Rows for a results file, as they are finished."""
    context = multiprocessing.get_context("spawn")
    shares: Queue[list[int]] = context.Queue()
    for share in core_shares(workers):
        shares.put(share)
    # The numerical libraries of a new process read these variables when they are loaded.
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    with ProcessPoolExecutor(workers, context, _take_cores, (shares,)) as pool:
        waiting = [pool.submit(outcome, job) for job in jobs]
        try:
            for done in as_completed(waiting):
                yield done.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def core_shares(workers: int) -> list[list[int]]:
    """The cores that this process may use, divided among the workers."""
    cores = sorted(os.sched_getaffinity(0))
    return [cores[first::workers] for first in range(workers)]


def _take_cores(shares: Queue[list[int]]) -> None:
    os.sched_setaffinity(0, shares.get())


def outcome(job: Job) -> dict[str, Any]:
    """Run one case. An error becomes the case's outcome and does not stop the other cases."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "case"
        truth = write(path, draw(job.tier, job.seed))
        row: dict[str, Any] = {"by": job.by, "engine": engine(), "truth": truth, "said": None, "error": ""}
        try:
            case = read_case(path)
            _compile(case)
            began_s, began_cpu_s = time.perf_counter(), time.process_time()
            row["said"] = _look(job.by)(case)
            row |= {"cpu_s": time.process_time() - began_cpu_s, "wall_s": time.perf_counter() - began_s}
            if job.fresh:
                row["fresh"] = _fresh(path)
            as_outcome(row)
        except Exception as error:
            row |= {"said": None, "error": f"{type(error).__name__}: {error}"}
        return row


def _look(by: str) -> Callable[[Case], dict[str, Any]]:
    return discrepancy_peers.peer(by) if by != DIAGNOSE else lambda case: diagnose(case).as_json()


def _compile(case: Case) -> None:
    """Run a simulation once: it compiles the plant, or loads it from the cache."""
    problem = FitProblem(case, (SensorNoise(1.0), SensorNoise(1.0)))
    problem.residuals(problem.start())


def _fresh(case: Path) -> dict[str, float]:
    began_s = time.perf_counter()
    ran = subprocess.run([sys.executable, str(_FRESH), str(case)], capture_output=True, text=True, check=True)
    told: dict[str, float] = json.loads(ran.stdout)
    return told | {"wall_s": time.perf_counter() - began_s}


@cache
def engine() -> str:
    """A short digest of the sources that determine cases and verdicts."""
    digest = hashlib.sha256()
    for folder in _SOURCES:
        for file in sorted(folder.rglob("*.py")):
            digest.update(file.read_bytes())
    return digest.hexdigest()[:8]
