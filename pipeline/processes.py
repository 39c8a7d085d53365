"""Threads that run before other programs, processes that end with their parent, and what a with block closes."""

import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Self


class Closing:
    """What goes on until it is closed; a ``with`` block closes it, whatever happens in it."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def close(self) -> object:
        """End it; a second call does nothing."""
        raise NotImplementedError


def is_running(process: int) -> bool:
    """Whether there is a process of this number, of whomever it is."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


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


def leave_signals_to_parent() -> None:
    """In a process of ours: a terminal sends its signals to all of a group, and the parent decides what they mean."""
    for name in ("SIGINT", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


def begin_worker(parent: int | None) -> None:
    """In a worker: Ctrl-C is left to the parent, and a parent that was killed takes its workers along.

    Args:
        parent: its number; None where another process forks the workers, which ends with the parent.
    """
    leave_signals_to_parent()
    threading.Thread(target=_end_with, args=(os.getppid() if parent is None else parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(LOOK)
    os._exit(1)


PRIORITY = 10
"""Of 1 to 99: above every ordinary program, below what the system itself runs with."""
PROMPT = PRIORITY + 1
"""Of threads that wait for something and are done with it at once: two of equal rank wait for each other, 100 ms at
most on Linux, and so a state that arrived would wait until the loop has computed."""
SWITCH = 0.001
"""How long one thread of a program may keep the others waiting in Python [s]; 5 ms is half a cycle."""
LOCK_EVERYTHING = 1 | 2 | 4
"""``MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT`` of ``sys/mman.h``."""


def ask_for_real_time() -> bool:
    """Have all threads of this program run before ordinary programs; those started later inherit it.

    Returns:
        Whether it was granted: to the superuser, or where ``/etc/security/limits.conf`` grants ``rtprio``.
    """
    sys.setswitchinterval(SWITCH)
    if not hasattr(os, "sched_setscheduler"):  # macOS, Windows
        return False
    try:
        for thread in threading.enumerate():
            if thread.native_id is not None:
                rank = PROMPT if isinstance(thread, PromptThread) else PRIORITY
                os.sched_setscheduler(thread.native_id, os.SCHED_RR, os.sched_param(rank))
    except OSError:
        return False
    _keep_in_memory()
    return True


class PromptThread(threading.Thread):
    """A daemon thread that receives or guards: with real-time priority it goes before those that compute."""

    def __init__(self, target: Callable[[], None], name: str) -> None:
        super().__init__(target=target, name=name, daemon=True)

    def run(self) -> None:
        """See `threading.Thread.run`."""
        if hasattr(os, "sched_setscheduler") and os.sched_getscheduler(0) == os.SCHED_RR:
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(PROMPT))
        super().run()


def _keep_in_memory() -> None:
    """Keep what is in memory there, where that is granted: code that a disk has to bring back delays a command."""
    if sys.platform != "linux":
        return
    import resource

    # Under a limit, memory that is asked for later would be refused.
    if os.geteuid() == 0 or resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY:
        ctypes.CDLL(None).mlockall(LOCK_EVERYTHING)


def be_ordinary() -> None:
    """Give it back, in a process that computes for seconds beside such a program: it must never make a loop wait."""
    if hasattr(os, "sched_setscheduler") and os.sched_getscheduler(0) == os.SCHED_RR:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
