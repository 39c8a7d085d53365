"""Real-time priority of a program's threads, and the base class of objects that a ``with`` block closes."""

import ctypes
import os
import sys
import threading
from collections.abc import Callable
from typing import Self


class Closable:
    """Base class of an object with a method `close`, which a ``with`` block calls at its end, also on an exception."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def close(self) -> object:
        """Stop the object's work and release its resources; a second call does nothing."""
        raise NotImplementedError


REAL_TIME_PRIORITY = 10
"""Real-time priority of the program's threads, from 1 to 99: above ordinary programs, below threads of the system."""
WAITING_THREAD_PRIORITY = REAL_TIME_PRIORITY + 1
"""Real-time priority of threads that mostly wait and then need little time, such as receivers.

It is higher than that of the control loop: on Linux, threads of equal priority may wait 100 ms for each other.
"""
THREAD_SWITCH_SECONDS = 0.001
"""Time after which Python lets another thread of the program run [s]; the default of 5 ms is half a control cycle."""
MLOCKALL_FLAGS = 1 | 2 | 4
"""Flags for mlockall: ``MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT`` of ``sys/mman.h``."""


def request_real_time_priority() -> bool:
    """Give all threads of this program real-time priority; threads that are started later inherit it.

    Returns:
        Whether the operating system granted it: to the superuser, or where ``/etc/security/limits.conf`` grants
        ``rtprio``.
    """
    sys.setswitchinterval(THREAD_SWITCH_SECONDS)
    if not hasattr(os, "sched_setscheduler"):  # macOS, Windows
        return False
    try:
        for thread in threading.enumerate():
            if thread.native_id is not None:
                rank = WAITING_THREAD_PRIORITY if isinstance(thread, HighPriorityThread) else REAL_TIME_PRIORITY
                os.sched_setscheduler(thread.native_id, os.SCHED_RR, os.sched_param(rank))
    except OSError:
        return False
    _keep_in_memory()
    return True


class HighPriorityThread(threading.Thread):
    """A daemon thread that receives data or supervises; under real-time priority it runs before computing threads.

    Args:
        target: function that the thread runs.
        name: name of the thread.
    """

    def __init__(self, target: Callable[[], None], name: str) -> None:
        super().__init__(target=target, name=name, daemon=True)

    def run(self) -> None:
        """Raise the thread's priority where the program has real-time priority, and run its target."""
        if hasattr(os, "sched_setscheduler") and os.sched_getscheduler(0) == os.SCHED_RR:
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(WAITING_THREAD_PRIORITY))
        super().run()


def _keep_in_memory() -> None:
    """Keep the process's memory from being swapped to disk, which would delay a motion command."""
    if sys.platform != "linux":
        return
    import resource

    # Under a limit, memory that is asked for later would be refused.
    if os.geteuid() == 0 or resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY:
        ctypes.CDLL(None).mlockall(MLOCKALL_FLAGS)


def drop_real_time_priority() -> None:
    """Give up the real-time priority of this process, so that its computation cannot delay the control loop."""
    if hasattr(os, "sched_setscheduler") and os.sched_getscheduler(0) == os.SCHED_RR:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
