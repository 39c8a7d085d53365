"""A pool of processes that ends with its parent, however that ends."""

import os
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context

LOOK = 0.5
"""Time between two looks of a worker whether its parent is still there [s]."""


@contextmanager
def worker_pool(workers: int, start: str | None = None) -> Iterator[ProcessPoolExecutor]:
    """A pool whose workers are ended at once where the block ends by an exception, such as Ctrl-C.

    Args:
        workers: how many processes.
        start: how they begin, as `multiprocessing` calls it; Python's usual way when not given. Where pools come and
            go, ``"forkserver"``: a forked copy of a process with threads can hang.
    """
    parent = os.getpid() if start in (None, "fork") else None
    pool = ProcessPoolExecutor(workers, get_context(start), initializer=begin_worker, initargs=(parent,))
    try:
        yield pool
    except BaseException:
        running = list((pool._processes or {}).values())  # Python 3.14 has a public way
        pool.shutdown(wait=False, cancel_futures=True)
        for process in running:
            process.kill()
        raise
    pool.shutdown()


def begin_worker(parent: int | None) -> None:
    """In a worker: Ctrl-C is left to the parent, and a parent that was killed takes its workers along.

    Args:
        parent: its number; None where another process forks the workers, which ends with the parent.
    """
    for name in ("SIGINT", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_end_with, args=(os.getppid() if parent is None else parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(LOOK)
    os._exit(1)
