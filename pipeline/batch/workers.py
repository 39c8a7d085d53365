"""Workers of a batch's jobs: processes on this machine, or a dask cluster."""

from collections.abc import Callable, Iterator, Sequence
from multiprocessing import set_forkserver_preload

from ik.workers import Lost, in_processes, on_cluster
from pipeline.batch.work import Job, Outcome, lost_outcome, work

START_METHOD = "forkserver"
"""How processes begin: with everything loaded, and free of the threads of this one."""
LOADED = ("armdyn.arm.model", "armdyn.pendulum.model", "armdyn.identify.repair", "pipeline.answers")
"""What they share."""


def outcomes(
    jobs: Sequence[Job], workers: int, scheduler: str | None, stopped: Callable[[], bool]
) -> Iterator[Outcome]:
    """Do jobs, and yield outcomes as they finish; a job whose workers die has an outcome too.

    Args:
        jobs: jobs to do; every worker of a cluster must have their files under the same paths.
        workers: number of processes on this machine.
        scheduler: address of a dask cluster that does the work instead.
        stopped: called often; where it returns True, the iteration ends.

    Raises:
        InputError: dask is missing, or the scheduler does not answer.
        TaskFailedError: the scheduler is gone.
    """
    if scheduler is None:
        if START_METHOD == "forkserver":
            set_forkserver_preload(list(LOADED))
        done = in_processes(work, jobs, workers, START_METHOD, stopped)
    else:
        done = on_cluster(work, jobs, scheduler, "batch", stopped)
    for job, outcome in done:
        yield lost_outcome(job, outcome.reason) if isinstance(outcome, Lost) else outcome
