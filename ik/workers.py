"""Distribute items of work to processes of this computer or a dask cluster; an item is repeated if its worker dies."""

import queue
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any, TypeVar

from armdyn.errors import InputError, TaskFailedError
from ik.child_processes import worker_pool

STOP_CHECK_PERIOD_SECONDS = 0.2
"""Interval at which it is checked whether the user wants to stop [s]."""
ITEMS_SUBMITTED_PER_WORKER = 2
"""Number of items that are submitted per worker, so that the next item waits when one is finished."""
MAX_WORKER_DEATHS_PER_ITEM = 2
"""Number of times that a worker may die while an item is computed before the item is given up; the last time the item
is computed alone."""
DASK_CONNECT_TIMEOUT_SECONDS = 10.0
"""Longest wait for a dask scheduler [s]."""

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class FailedWorkItem:
    """Result of an item whose workers died repeatedly; `reason` says what happened, without a full stop."""

    reason: str


class _StoppedError(Exception):
    """The user wants to stop."""


def map_in_processes(
    work: Callable[[Item], Result],
    items: Iterable[Item],
    workers: int,
    start: str,
    stopped: Callable[[], bool] = lambda: False,
) -> Iterator[tuple[Item, Result | FailedWorkItem]]:
    """Call a function for each item in several processes of this computer; yield items and results as they finish.

    Args:
        work: the function, or another callable that can be pickled.
        items: arguments of the calls.
        workers: number of processes.
        start: start method of `multiprocessing`, such as ``"spawn"``.
        stopped: function that is called often; when it returns True, the processes are killed and the iteration ends.
    """
    left, alone = deque(enumerate(items)), deque[tuple[int, Item]]()
    deaths: Counter[int] = Counter()
    while left or alone:
        together = bool(left)
        source, crew = (left, workers) if together else (alone, 1)
        running: dict[Future[Result], tuple[int, Item]] = {}
        try:
            with worker_pool(crew, start) as pool:
                while source or running:
                    while source and len(running) < (ITEMS_SUBMITTED_PER_WORKER * crew if together else 1):
                        number, item = source.popleft()
                        running[pool.submit(work, item)] = number, item
                    if stopped():
                        raise _StoppedError
                    for future in wait(running, STOP_CHECK_PERIOD_SECONDS, FIRST_COMPLETED).done:
                        result = future.result()
                        yield running.pop(future)[1], result
        except _StoppedError:
            return
        except BrokenProcessPool:
            for future, (number, item) in running.items():
                if future.done() and future.exception() is None:
                    yield item, future.result()
                    continue
                deaths[number] += 1
                if deaths[number] >= MAX_WORKER_DEATHS_PER_ITEM and not together:
                    yield item, FailedWorkItem(f"the process that worked on it died {deaths[number]} times")
                else:
                    alone.append((number, item))


def map_on_cluster(
    work: Callable[[Item], Result],
    items: Sequence[Item],
    scheduler: str,
    extra: str,
    stopped: Callable[[], bool] = lambda: False,
) -> Iterator[tuple[Item, Result | FailedWorkItem]]:
    """Call a function for each item on a dask cluster; yield items and results as they finish.

    The items of a worker that dies are given to other workers.

    Args:
        work: the function, or another callable that the workers can unpickle; it is sent with every item.
        items: arguments of the calls.
        scheduler: address of the dask scheduler, such as ``tcp://host:8786``.
        extra: name of the extra of armdyn that installs dask, for the error message.
        stopped: function that is called often; when it returns True, the iteration ends.

    Raises:
        InputError: dask is not installed, or the scheduler does not answer.
        TaskFailedError: the connection to the scheduler was lost.
    """
    client = _client(scheduler, extra)
    from distributed import KilledWorker

    with client:
        done: queue.SimpleQueue[Any] = queue.SimpleQueue()
        futures = {client.submit(work, item, pure=False): item for item in items}
        for future in futures:
            future.add_done_callback(done.put)
        try:
            while futures and not stopped():
                try:
                    future = done.get(timeout=STOP_CHECK_PERIOD_SECONDS)
                except queue.Empty:
                    continue
                item = futures.pop(future)
                gone = f"{scheduler}: the scheduler is gone, {len(futures) + 1} of {len(items)} are left; "
                gone += "the same command continues"
                if future.status in ("cancelled", "lost"):
                    raise TaskFailedError(gone)
                result: Result | FailedWorkItem
                try:
                    result = future.result()
                except KilledWorker:
                    result = FailedWorkItem("several workers died of it")
                except OSError as error:
                    raise TaskFailedError(gone) from error
                future.release()
                yield item, result
        finally:
            client.cancel(list(futures))


def _client(scheduler: str, extra: str) -> Any:
    """A `distributed.Client`, to be closed by its ``with`` block."""
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(f"--scheduler needs dask: run 'pip install armdyn[{extra}]'") from error
    try:
        return Client(scheduler, timeout=DASK_CONNECT_TIMEOUT_SECONDS, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"{scheduler}: no dask scheduler answers there; start one with 'dask scheduler'") from error
