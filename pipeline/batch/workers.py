"""Who does the jobs of a batch: processes of this machine, or the workers of a dask cluster."""

from collections.abc import Callable, Iterator, Sequence
from multiprocessing import set_forkserver_preload

from ik.workers import Lost, in_processes, on_cluster
from pipeline.batch.work import Job, Outcome, lost_outcome, work

START = "forkserver"
"""How processes begin: with everything loaded, and free of the threads of this one."""
LOADED = ("armdyn.arm.model", "armdyn.pendulum.model", "armdyn.identify.repair", "pipeline.answers")
"""What they share."""


def outcomes(
    jobs: Sequence[Job], workers: int, scheduler: str | None, stopped: Callable[[], bool]
) -> Iterator[Outcome]:
    """Do jobs, in the order in which they get done; one of which workers die is an outcome as well.

    Args:
        jobs: what to do; their files must be there, under the same paths, on every worker of a cluster.
        workers: processes of this machine.
        scheduler: address of a dask cluster that does it instead.
        stopped: asked often; where it says so, the iteration ends.

    Raises:
        InputError: dask is missing, or the scheduler does not answer.
        TaskFailedError: the scheduler is gone.
    """
    if scheduler is None:
        if START == "forkserver":
            set_forkserver_preload(list(LOADED))
        done = in_processes(work, jobs, workers, START, stopped)
    else:
        done = on_cluster(work, jobs, scheduler, "batch", stopped)
    for job, outcome in done:
        yield lost_outcome(job, outcome.reason) if isinstance(outcome, Lost) else outcome
