"""Share work among processes of this machine or the workers of a dask cluster; each item is done once, whoever dies."""

import queue
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any, TypeVar

from armdyn.errors import InputError, TaskFailedError
from ik.children import worker_pool

STOP_CHECK_SECONDS = 0.2
"""Interval at which the user's wish to stop is checked, s."""
ITEMS_PER_WORKER = 2
"""Number of items in hand per worker: one is there when another is done. Where a worker dies, they are suspects."""
MAX_DEATHS_PER_ITEM = 2
"""Number of times that a worker may die of one item, the second time alone, before the item is given up."""
CONNECT_TIMEOUT_SECONDS = 10.0
"""Longest wait for a scheduler, s."""

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Lost:
    """The result of an item of which workers died: a sentence, without a full stop, on what happened."""

    reason: str


class _StoppedError(Exception):
    """The user wants to stop."""


def in_processes(
    work: Callable[[Item], Result],
    items: Iterable[Item],
    workers: int,
    start: str,
    stopped: Callable[[], bool] = lambda: False,
) -> Iterator[tuple[Item, Result | Lost]]:
    """Do work on this machine; yield items and results in the order in which they are finished.

    Args:
        work: a function of a module, or an object that can be pickled.
        items: items of work.
        workers: number of processes.
        start: start method, as `multiprocessing` calls it.
        stopped: function that is called often; where it returns True, workers are ended at once and the iteration ends.
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
                    while source and len(running) < (ITEMS_PER_WORKER * crew if together else 1):
                        number, item = source.popleft()
                        running[pool.submit(work, item)] = number, item
                    if stopped():
                        raise _StoppedError
                    for future in wait(running, STOP_CHECK_SECONDS, FIRST_COMPLETED).done:
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
                if deaths[number] >= MAX_DEATHS_PER_ITEM and not together:
                    yield item, Lost(f"the process that worked on it died {deaths[number]} times")
                else:
                    alone.append((number, item))


def on_cluster(
    work: Callable[[Item], Result],
    items: Sequence[Item],
    scheduler: str,
    extra: str,
    stopped: Callable[[], bool] = lambda: False,
) -> Iterator[tuple[Item, Result | Lost]]:
    """Do work on a dask cluster; yield items and results as they are finished. Items of lost workers go to others.

    The workers must be able to import or unpickle `work`, which is sent with every item, so that a lost worker loses
    nothing. The scheduler has an address such as ``tcp://host:8786``; `extra` is the extra of armdyn that installs
    dask; for `stopped` see `in_processes`.

    Raises:
        InputError: dask is missing, or the scheduler does not answer.
        TaskFailedError: the scheduler is gone.
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
                    future = done.get(timeout=STOP_CHECK_SECONDS)
                except queue.Empty:
                    continue
                item = futures.pop(future)
                gone = f"{scheduler}: the scheduler is gone, {len(futures) + 1} of {len(items)} are left; "
                gone += "the same command continues"
                if future.status in ("cancelled", "lost"):
                    raise TaskFailedError(gone)
                result: Result | Lost
                try:
                    result = future.result()
                except KilledWorker:
                    result = Lost("several workers died of it")
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
        return Client(scheduler, timeout=CONNECT_TIMEOUT_SECONDS, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"{scheduler}: no dask scheduler answers there; start one with 'dask scheduler'") from error
