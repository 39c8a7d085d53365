"""A user's code, first done in a copy of this process: it may take for ever, or all memory, or exit.

What the copy does changes nothing here. The kernel limits its memory, a timer that needs no Python its time.
"""

import faulthandler
import os
import pickle
import re
import select
import signal
import sys
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

from armdyn.errors import ArmdynError, InputError
from urdf.bounds import MIB, USER_MEMORY, USER_SECONDS

PATIENCE = 2.0
"""s that a copy may take to tell where it was when its time was up."""
_OUTCOME = b"outcome:"


def rehearse(path: Path, work: Callable[[], object]) -> None:
    """Do something that runs a user's file in a copy of this process; where there are no copies, do nothing.

    Args:
        path: the user's file.
        work: what is to be done; its result is lost.

    Raises:
        ArmdynError: what `work` raised.
        InputError: it takes too long or too much memory, or ends the process; names the file and, if known, the line.
    """
    if not hasattr(os, "fork"):
        return
    reading, writing = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of a copy with threads: it takes no lock of theirs
        child = os.fork()
    if child == 0:
        os.close(reading)
        _perform(path, work, writing)
    os.close(writing)
    try:
        said = _read(reading)
    finally:
        os.close(reading)
        with suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
    if said.startswith(_OUTCOME):
        outcome = pickle.loads(said[len(_OUTCOME) :])
        if outcome is None:
            return
        raise outcome
    raise InputError(f"{path}{_line_in(said.decode(errors='replace'), path)}: {_why(said, status)}")


def _read(pipe: int) -> bytes:
    """What is said until the last end is closed, or for a little longer than the copy may live."""
    said, end = b"", time.monotonic() + USER_SECONDS + PATIENCE
    while select.select([pipe], [], [], max(0.0, end - time.monotonic()))[0] and (part := os.read(pipe, 65536)):
        said += part
    return said


def _perform(path: Path, work: Callable[[], object], writing: int) -> NoReturn:
    """In the copy."""
    with suppress(BaseException):
        # Nobody is to read what the user's file prints twice, nor is anybody asked.
        quiet = os.open(os.devnull, os.O_RDWR)
        for descriptor in (0, 1, 2):
            os.dup2(quiet, descriptor)
        sys.stdout = sys.stderr = os.fdopen(quiet, "w")
        faulthandler.disable()
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)
        _limit_memory()
        faulthandler.dump_traceback_later(USER_SECONDS, exit=True, file=writing)
        outcome: BaseException | None = None
        try:
            work()
        except ArmdynError as error:
            outcome = error
        except BaseException as error:
            from armdyn.effects.tried import line_in

            line = line_in(error, path)
            said = " ".join(f"{type(error).__name__}: {error}".split())
            outcome = InputError(f"{path}{f', line {line}' if line else ''}: {said[:300]}")
        faulthandler.cancel_dump_traceback_later()
        os.write(writing, _OUTCOME + pickle.dumps(outcome))
    os._exit(0)


def _limit_memory() -> None:
    if sys.platform != "linux":
        return
    import resource

    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + USER_MEMORY
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def _line_in(trace: str, path: Path) -> str:
    """Where a trace was in a file, the innermost line."""
    found = re.search(rf'File "{re.escape(str(path))}", line (\d+)', trace)
    return f", line {found[1]}" if found else ""


def _why(said: bytes, status: int) -> str:
    if said.startswith(b"Timeout") or (os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGKILL):
        return f"takes longer than {USER_SECONDS:g} s: do less there"
    if os.WIFSIGNALED(status):
        return f"ends the program by {signal.Signals(os.WTERMSIG(status)).name}: mend it"
    return f"ends the program, or takes more than {USER_MEMORY / MIB:g} MiB: mend it"
