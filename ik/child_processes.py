"""Child processes that ignore terminal signals and end when their parent process ends."""

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import connection, get_context
from typing import Any

PARENT_GONE_EXIT_STATUS = 1
"""Exit status of a child process whose parent has ended."""


@contextmanager
def worker_pool(workers: int, start: str | None = None) -> Iterator[ProcessPoolExecutor]:
    """A pool of processes that are killed at once if an exception, such as Ctrl-C, ends the ``with`` block.

    Args:
        workers: number of processes.
        start: start method of `multiprocessing`, by default Python's own. A program that creates several pools should
            use ``"forkserver"``, because a forked copy of a process with threads can hang.
    """
    pool = ProcessPoolExecutor(workers, get_context(start), initialise_child)
    try:
        yield pool
    except BaseException:
        running = list((pool._processes or {}).values())  # Python 3.14 has a public way
        pool.shutdown(wait=False, cancel_futures=True)
        for process in running:
            process.kill()
        raise
    pool.shutdown()


def initialise_child() -> None:
    """Initialise a child process: ignore terminal signals, end with the parent, compute with one thread."""
    from armdyn.threads import use_one_thread_permanently  # takes half a second, which a parent may not need

    _leave_signals_to_parent()
    _end_with_parent()
    use_one_thread_permanently()


def _leave_signals_to_parent() -> None:
    """Ignore SIGINT and SIGHUP, which a terminal sends to all processes of a command: only the parent reacts."""
    for name in ("SIGINT", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _end_with_parent() -> None:
    """End this process when its parent does.

    Each child holds one end of a pipe whose other end only the parent has. On Linux the kernel kills the child when the
    pipe breaks, also while C code keeps Python's lock; elsewhere a thread waits for it.
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    if sys.platform == "linux":
        import fcntl

        pipe = parent.sentinel
        fcntl.fcntl(pipe, fcntl.F_SETSIG, signal.SIGKILL)
        fcntl.fcntl(pipe, fcntl.F_SETOWN, os.getpid())
        fcntl.fcntl(pipe, fcntl.F_SETFL, fcntl.fcntl(pipe, fcntl.F_GETFL) | os.O_ASYNC)
        if connection.wait([pipe], 0):  # it was gone before the kernel was asked
            os._exit(PARENT_GONE_EXIT_STATUS)
    else:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: Any) -> None:
    parent.join()
    os._exit(PARENT_GONE_EXIT_STATUS)


def is_running(process: int) -> bool:
    """Whether a process with this process number runs on this computer, of any user."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
