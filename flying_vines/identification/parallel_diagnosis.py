"""Diagnoses many cases in parallel: on all cores of this machine, or on a Dask cluster.

    for path, outcome in diagnose_all(sorted(Path("season").iterdir())): ...

By default there is one process for each core. A case that cannot be read or diagnosed does not stop the
others.
"""

from __future__ import annotations

import signal
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path

from flying_vines.files.extras import install_command
from flying_vines.identification.case import Case, read_case
from flying_vines.identification.diagnose import diagnose
from flying_vines.identification.from_log import read_flight
from flying_vines.identification.importing.runs import is_foreign, read_imported
from flying_vines.identification.recording import CaseError
from flying_vines.identification.simulate import THREADS, cores
from flying_vines.identification.verdict import Verdict
from flying_vines.record.reader import is_flight

AHEAD = 2
"""Running and queued cases for each process: no process waits for work, and few cases are in memory."""
ANSWER_S = 5.0
"""Maximum time until the scheduler of a cluster answers."""
CaseOutcome = Verdict | CaseError
Job = tuple[Path, Case | Path | CaseError]
"""The path of a case, and the case itself, or the path to read it from, or the error from reading it."""


class ClusterError(ValueError):
    """A cluster cannot be used; its text is one sentence for people."""


def read_any(path: Path | str, rig: Path | str | None = None) -> Case:
    """The case in a folder of runs, a CSV file of any layout, or a flight log."""
    path = Path(path)
    if is_flight(path):
        return read_flight(path, rig)
    return read_imported(path, rig) if is_foreign(path) else read_case(path, rig)


def diagnose_all(
    cases: Sequence[Case | Path | str],
    workers: int | None = None,
    scheduler: str | None = None,
    rig: Path | str | None = None,
) -> Iterator[tuple[Path, CaseOutcome]]:
    """The verdicts as they arrive, each with the path of its case; a CaseError if there is no verdict.

    Args:
        cases: cases, or their paths.
        workers: number of processes; default: the number of cores that this process may use.
        scheduler: address of a Dask scheduler; its workers diagnose the cases. This process reads the files.
        rig: a rig file for all cases that are given as paths; default: each case has its own.

    Raises ClusterError if the cluster cannot be used.
    """
    jobs: Iterable[Job] = [(c.path, c) if isinstance(c, Case) else (Path(c), Path(c)) for c in cases]
    if scheduler is not None:
        with _cluster(scheduler) as (pool, at_once):
            yield from _as_completed(pool, (_read(job, rig) for job in jobs), at_once, 1, rig)
        return
    workers = min(workers or cores(), len(cases))
    if workers <= 1:
        for job in jobs:
            yield job[0], _outcome(job, 0, rig)
        return
    # Spawned, because a fork would copy locks that threads of numerical libraries hold.
    with ProcessPoolExecutor(workers, get_context("spawn"), _ignore_interrupts) as pool:
        try:
            yield from _as_completed(pool, jobs, workers, max(1, cores() // workers), rig)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _as_completed(
    pool: Executor, jobs: Iterable[Job], at_once: int, threads: int, rig: Path | str | None
) -> Iterator[tuple[Path, CaseOutcome]]:
    waiting: dict[Future[CaseOutcome], Path] = {}
    for job in jobs:
        waiting[_submit(pool, job, threads, rig)] = job[0]
        if len(waiting) >= AHEAD * at_once:
            yield from _finished(waiting)
    while waiting:
        yield from _finished(waiting)


def _submit(pool: Executor, job: Job, threads: int, rig: Path | str | None) -> Future[CaseOutcome]:
    try:
        return pool.submit(_outcome, job, threads, rig)
    except RuntimeError as error:  # a pool that has lost a process accepts no jobs
        lost: Future[CaseOutcome] = Future()
        lost.set_exception(error)
        return lost


def _finished(waiting: dict[Future[CaseOutcome], Path]) -> Iterator[tuple[Path, CaseOutcome]]:
    for future in wait(waiting, return_when=FIRST_COMPLETED).done:
        path = waiting.pop(future)
        try:
            yield path, future.result()
        except Exception as error:
            yield path, CaseError(f"{path}: the process gave no verdict: {type(error).__name__}: {error}")


def _read(job: Job, rig: Path | str | None) -> Job:
    path, what = job
    try:
        return path, read_any(what, rig) if isinstance(what, Path) else what
    except CaseError as error:
        return path, error


def _outcome(job: Job, threads: int, rig: Path | str | None) -> CaseOutcome:
    """Diagnose one case in this process."""
    path, what = _read(job, rig)
    if not isinstance(what, Case):
        assert isinstance(what, CaseError)
        return what
    before = THREADS.set(threads)
    try:
        return diagnose(what)
    except Exception as error:  # an error in one case must not stop the others
        return CaseError(f"{path}: could not be diagnosed: {type(error).__name__}: {error}")
    finally:
        THREADS.reset(before)


def _ignore_interrupts() -> None:
    """Ctrl-C reaches all processes; the parent process ends this one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def _cluster(address: str) -> Iterator[tuple[Executor, int]]:
    """The workers of a cluster, and the number of cases that they can run in parallel."""
    try:
        from distributed import Client
        from distributed.comm import get_address_host_port
    except ModuleNotFoundError as error:
        why = f"a scheduler needs {error.name}, which is missing: {install_command('cluster')}"
        raise ClusterError(why) from None
    try:
        # A client with an empty address would hang when it closes.
        get_address_host_port(address)
        client = Client(address, timeout=ANSWER_S, set_as_default=False)
    except ValueError as error:
        raise ClusterError(f"{address}: is not a scheduler's address such as HOST:8786: {error}") from None
    except OSError:
        raise ClusterError(f"{address}: no Dask scheduler answers there within {ANSWER_S:g} s") from None
    with client:
        at_once = sum(client.nthreads().values())
        if at_once == 0:
            raise ClusterError(f"{address}: this scheduler has no workers; start some: dask worker {address}")
        pool = client.get_executor(pure=False)
        try:
            yield pool, at_once
        finally:
            pool.shutdown(wait=False)
