"""Many cases at once: on all cores of this machine, or on a Dask cluster.

    for path, outcome in diagnose_all(sorted(Path("season").iterdir())): ...

Each case is diagnosed in another process, as many at once as there are cores, each on its share of them.
A case that cannot be read or diagnosed stops no other.
"""

from __future__ import annotations

import signal
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path

from flying_vines.identification.case import Case, read_case
from flying_vines.identification.cores import THREADS, cores
from flying_vines.identification.diagnose import diagnose
from flying_vines.identification.from_log import is_flight, read_flight
from flying_vines.identification.importing.runs import is_foreign, read_imported
from flying_vines.identification.recording import CaseError
from flying_vines.identification.verdict import Verdict

AHEAD = 2
"""So many cases a process are handed out at once: none waits for work, and no season has to be in memory."""
ANSWER_S = 5.0
"""Within this a cluster has to answer."""
CaseOutcome = Verdict | CaseError
Job = tuple[Path, Case | Path | CaseError]
"""Where a case is, and the case, or where it is still to be read from, or why it could not be."""


class ClusterError(ValueError):
    """A cluster that cannot be used; its text is one sentence for people."""


def read_any(path: Path | str, rig: Path | str | None = None) -> Case:
    """The case of a folder of runs, a CSV file, a flight log or its folder; as `read_case`, `read_flight`."""
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
    """The verdicts as they come, each with its case's path; a CaseError for a case that has none.

    Args:
        cases: what was read, or where it is.
        workers: how many processes; unless given, as many as this process may use cores.
        scheduler: the address of a Dask scheduler, whose workers diagnose instead. Files are read here.
        rig: a rig file for all that are still to be read; unless given, each has its own.

    Raises ClusterError when there is no such cluster.
    """
    jobs: Iterable[Job] = [(c.path, c) if isinstance(c, Case) else (Path(c), Path(c)) for c in cases]
    if scheduler is not None:
        with _cluster(scheduler) as (pool, at_once):
            yield from _as_they_come(pool, (_read(job, rig) for job in jobs), at_once, 1, rig)
        return
    workers = min(workers or cores(), len(cases))
    if workers <= 1:
        for job in jobs:
            yield job[0], _outcome(job, 0, rig)
        return
    # Spawned, for a fork would take over locks that threads of numerical libraries hold.
    with ProcessPoolExecutor(workers, get_context("spawn"), _ignore_interrupts) as pool:
        try:
            yield from _as_they_come(pool, jobs, workers, max(1, cores() // workers), rig)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _as_they_come(
    pool: Executor, jobs: Iterable[Job], at_once: int, threads: int, rig: Path | str | None
) -> Iterator[tuple[Path, CaseOutcome]]:
    waiting: dict[Future[CaseOutcome], Path] = {}
    for job in jobs:
        waiting[_handed_out(pool, job, threads, rig)] = job[0]
        if len(waiting) >= AHEAD * at_once:
            yield from _finished(waiting)
    while waiting:
        yield from _finished(waiting)


def _handed_out(pool: Executor, job: Job, threads: int, rig: Path | str | None) -> Future[CaseOutcome]:
    try:
        return pool.submit(_outcome, job, threads, rig)
    except RuntimeError as error:  # a pool that lost a process takes nothing any more
        lost: Future[CaseOutcome] = Future()
        lost.set_exception(error)
        return lost


def _finished(waiting: dict[Future[CaseOutcome], Path]) -> Iterator[tuple[Path, CaseOutcome]]:
    for future in wait(waiting, return_when=FIRST_COMPLETED).done:
        path = waiting.pop(future)
        try:
            yield path, future.result()
        except Exception as error:
            yield path, CaseError(f"{path}: no process brought a verdict: {type(error).__name__}: {error}")


def _read(job: Job, rig: Path | str | None) -> Job:
    path, what = job
    try:
        return path, read_any(what, rig) if isinstance(what, Path) else what
    except CaseError as error:
        return path, error


def _outcome(job: Job, threads: int, rig: Path | str | None) -> CaseOutcome:
    """Of one case, in whatever process and thread it is handed out to."""
    path, what = _read(job, rig)
    if not isinstance(what, Case):
        assert isinstance(what, CaseError)
        return what
    before = THREADS.set(threads)
    try:
        return diagnose(what)
    except Exception as error:  # no fault of ours may cost the others their verdicts
        return CaseError(f"{path}: could not be diagnosed: {type(error).__name__}: {error}")
    finally:
        THREADS.reset(before)


def _ignore_interrupts() -> None:
    """Whoever started this process ends it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def _cluster(address: str) -> Iterator[tuple[Executor, int]]:
    """A cluster's workers, and how many cases they can take at once."""
    try:
        from distributed import Client
        from distributed.comm import get_address_host_port
    except ModuleNotFoundError as error:
        raise ClusterError(
            f"a scheduler needs {error.name}, which is missing: pip install 'flying-vines[cluster]'"
        ) from None
    try:
        # A client that is given no address at all would wait for itself when it ends.
        get_address_host_port(address)
        client = Client(address, timeout=ANSWER_S, set_as_default=False)
    except ValueError as error:
        raise ClusterError(f"{address}: is no address of a scheduler, as HOST:8786 is: {error}") from None
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
