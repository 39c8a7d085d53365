"""Real-time priority of a program's threads, and the base of everything that a ``with`` block closes."""

import ctypes
import os
import sys
import threading
from collections.abc import Callable
from typing import Self


class Closing:
    """Something that runs until `close` is called; a ``with`` block closes it at its end, also after an exception."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def close(self) -> object:
        """End what runs; a second call does nothing."""
        raise NotImplementedError


REAL_TIME_PRIORITY = 10
"""Rank of the program's threads, from 1 to 99: above every ordinary program, below the threads of the system."""
PROMPT_PRIORITY = REAL_TIME_PRIORITY + 1
"""Of threads that wait for something and are done with it at once: two of equal rank wait for each other, 100 ms at
most on Linux, and so a state that arrived would wait until the loop has computed."""
SWITCH_SECONDS = 0.001
"""How long one thread of a program may keep the others waiting in Python [s]; 5 ms is half a cycle."""
LOCK_EVERYTHING = 1 | 2 | 4
"""``MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT`` of ``sys/mman.h``."""


def ask_for_real_time() -> bool:
    """Have all threads of this program run before ordinary programs; those started later inherit it.

    Returns:
        Whether it was granted: to the superuser, or where ``/etc/security/limits.conf`` grants ``rtprio``.
    """
    sys.setswitchinterval(SWITCH_SECONDS)
    if not hasattr(os, "sched_setscheduler"):  # macOS, Windows
        return False
    try:
        for thread in threading.enumerate():
            if thread.native_id is not None:
                rank = PROMPT_PRIORITY if isinstance(thread, PromptThread) else REAL_TIME_PRIORITY
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
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(PROMPT_PRIORITY))
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
    """Give up real-time priority, in a process that computes for seconds and must not delay the control loop."""
    if hasattr(os, "sched_setscheduler") and os.sched_getscheduler(0) == os.SCHED_RR:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
