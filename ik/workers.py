"""Work shared among processes of this machine, or the workers of a dask cluster; each item once, whoever dies."""

import queue
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any, TypeVar

from armdyn.errors import InputError, TaskFailedError
from ik.children import worker_pool

LOOK = 0.2
"""Time between two looks whether the user wants to stop, s."""
AHEAD = 2
"""Items in hand per worker: one is there when another is done. Those in hand are suspects where a worker dies."""
DEATHS = 2
"""Times that a worker may die of one item, the second time alone, before the item is given up."""
CONNECT = 10.0
"""To wait for a scheduler, s."""

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Lost:
    """What is given instead of a result where workers died of an item: how that went, as a sentence without a stop."""

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
    """Do work on this machine; items and results in the order in which they get done.

    Args:
        work: a function of a module, or an object that can be pickled.
        items: what to do it with.
        workers: processes.
        start: how they begin, as `multiprocessing` calls it.
        stopped: asked often; where it says so, workers are ended at once and the iteration ends.
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
                    while source and len(running) < (AHEAD * crew if together else 1):
                        number, item = source.popleft()
                        running[pool.submit(work, item)] = number, item
                    if stopped():
                        raise _StoppedError
                    for future in wait(running, LOOK, FIRST_COMPLETED).done:
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
                if deaths[number] >= DEATHS and not together:
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
    """Do work on a dask cluster, in the order in which it gets done; items of lost workers go to others.

    Args:
        work: what the workers can import or unpickle; it is sent with every item, so that no worker's loss loses it.
        items: what to do it with.
        scheduler: address, such as ``tcp://host:8786``.
        extra: of armdyn, that brings dask.
        stopped: as for `in_processes`.

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
                    future = done.get(timeout=LOOK)
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
        return Client(scheduler, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"{scheduler}: no dask scheduler answers there; start one with 'dask scheduler'") from error
