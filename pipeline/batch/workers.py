"""Who does the jobs: processes of this machine, or the workers of a dask cluster; each job once, whoever dies."""

import queue
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import set_forkserver_preload
from typing import Any

from armdyn.errors import TaskFailedError
from ik.children import worker_pool
from ik.cluster import dask_client
from pipeline.batch.work import Job, Outcome, lost_outcome, work

LOOK = 0.2
"""Time between two looks whether the user wants to stop, s."""
AHEAD = 2
"""Jobs in hand per worker: one is there when another is done. Those in hand are suspects where a worker dies."""
DEATHS = 2
"""Times that a worker may die of one job, the second time alone, before the job is given up."""

START = "forkserver"
"""How processes begin: with everything loaded, and free of the threads of this one."""
LOADED = ("armdyn.arm.model", "armdyn.pendulum.model", "armdyn.identify.repair", "pipeline.answers")
"""What they share."""

Stopped = Callable[[], bool]


class _StoppedError(Exception):
    """The user wants to stop."""


def in_processes(jobs: Iterable[Job], workers: int, stopped: Stopped) -> Iterator[Outcome]:
    """Do jobs on this machine, in the order in which they get done.

    Args:
        jobs: what to do.
        workers: processes.
        stopped: asked often; where it says so, workers are ended at once and the iteration ends.
    """
    if START == "forkserver":
        set_forkserver_preload(list(LOADED))
    left, alone = deque(jobs), deque[Job]()
    deaths: Counter[str] = Counter()
    while left or alone:
        together = bool(left)
        running: dict[Future[Outcome], Job] = {}
        try:
            with worker_pool(workers if together else 1, START) as pool:
                source = left if together else alone
                most = AHEAD * workers if together else 1
                while source or running:
                    while source and len(running) < most:
                        job = source.popleft()
                        running[pool.submit(work, job)] = job
                    if stopped():
                        raise _StoppedError
                    for future in wait(running, LOOK, FIRST_COMPLETED).done:
                        outcome = future.result()
                        del running[future]
                        yield outcome
        except _StoppedError:
            return
        except BrokenProcessPool:
            for future, job in list(running.items()):
                if future.done() and future.exception() is None:
                    yield future.result()
                    continue
                deaths[job.key] += 1
                if deaths[job.key] >= DEATHS and not together:
                    yield lost_outcome(job, f"the process that worked on it died {deaths[job.key]} times")
                else:
                    alone.append(job)


def on_cluster(jobs: Sequence[Job], scheduler: str, stopped: Stopped) -> Iterator[Outcome]:
    """Do jobs on a dask cluster, in the order in which they get done; jobs of lost workers go to others.

    Args:
        jobs: what to do; their files must be there, under the same paths, on every worker.
        scheduler: address, such as ``tcp://host:8786``.
        stopped: as for `in_processes`.

    Raises:
        InputError: dask is missing, or the scheduler does not answer.
        TaskFailedError: the scheduler is gone.
    """
    client = dask_client(scheduler, "batch")
    from distributed import KilledWorker

    with client:
        done: queue.SimpleQueue[Any] = queue.SimpleQueue()
        futures = {client.submit(work, job, pure=False, key=f"armdyn-{job.key}"): job for job in jobs}
        for future in futures:
            future.add_done_callback(done.put)
        try:
            while futures and not stopped():
                try:
                    future = done.get(timeout=LOOK)
                except queue.Empty:
                    continue
                job = futures.pop(future)
                if future.status in ("cancelled", "lost"):
                    raise TaskFailedError(_gone(scheduler, len(futures) + 1))
                try:
                    outcome = future.result()
                except KilledWorker:
                    outcome = lost_outcome(job, "several workers died of it")
                except OSError as error:
                    raise TaskFailedError(_gone(scheduler, len(futures) + 1)) from error
                future.release()
                yield outcome
        finally:
            client.cancel(list(futures))


def _gone(scheduler: str, left: int) -> str:
    return f"{scheduler}: the scheduler is gone, {left} recordings are left; the same command continues"
