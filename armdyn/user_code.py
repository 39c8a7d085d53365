"""Run a user's Python file, first in a copy of this process, and report whatever it raises in one line.

The copy may run for ever, take all memory or exit, without any change here: the kernel limits its memory, and a timer
outside Python its processor time, so that nothing is refused on a busy machine.
"""

import faulthandler
import importlib.util
import os
import pickle
import re
import select
import signal
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import ModuleType
from typing import NoReturn

from armdyn.errors import ArmdynError, InputError
from urdf.bounds import LARGEST_TEXT, MIB, USER_MEMORY, USER_SECONDS

MAX_WAIT_RATIO = 8.0
"""Time of the copy, as a multiple of its processor time limit, after which it counts as waiting for something."""
REPORT_SECONDS = 2.0
"""Time, s, in which a copy must report its line when its time is up."""
MAX_EXCEPTION_LENGTH = 300
"""Largest number of characters of an exception's message."""
_OUTCOME = b"outcome:"


def load_module(path: Path, holds: str) -> ModuleType:
    """Run a user's Python file and return it as a module; it may do anything that a Python program may do.

    Args:
        path: path of the file.
        holds: what the file should contain, such as ``"effects"``.

    Raises:
        InputError: the file cannot be read or run.
    """
    wanted = f"give the Python file with your {holds}"
    if path.is_dir():
        raise InputError(f"{path} is a directory: {wanted}")
    if not path.is_file():
        raise InputError(f"{path}: no such file: {wanted}")
    if path.stat().st_size > LARGEST_TEXT:
        raise InputError(f"{path}: is larger than {LARGEST_TEXT / MIB:g} MiB: {wanted}")
    spec = importlib.util.spec_from_file_location(f"armdyn_user_{holds}_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path}: is not a Python file: give one that ends in .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    with faults_in(path), warnings.catch_warnings():
        warnings.simplefilter("ignore", SyntaxWarning)  # style warnings are the user's own affair
        spec.loader.exec_module(module)
    return module


@contextmanager
def faults_in(path: Path) -> Iterator[None]:
    """Turn everything that a user's file raises into an `InputError` of one line, with the file and line."""
    try:
        yield
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise _fault(error, path) from error


def _fault(error: BaseException, path: Path) -> InputError:
    if isinstance(error, SystemExit):
        said = "ends the program: remove sys.exit or exit"
    else:
        said = " ".join((str(error) if isinstance(error, ArmdynError) else f"{type(error).__name__}: {error}").split())
    return InputError(said if said.startswith(str(path)) else f"{place_of(error, path)}: {said[:MAX_EXCEPTION_LENGTH]}")


def place_of(error: BaseException | None, path: Path) -> str:
    """The path of the file, with the last of its lines in an exception's traceback, where there is one."""
    line = error.lineno if isinstance(error, SyntaxError) else None
    trace = error.__traceback__ if error is not None else None
    while trace is not None:
        if Path(trace.tb_frame.f_code.co_filename) == path:
            line = trace.tb_lineno
        trace = trace.tb_next
    return f"{path}, line {line}" if line else str(path)


def rehearse(path: Path, work: Callable[[], object]) -> None:
    """Run `work`, which runs a user's file, in a copy of this process; do nothing where copies are not possible.

    Args:
        path: the user's file.
        work: function to call; its result is not used.

    Raises:
        ArmdynError: the error that `work` raised.
        InputError: `work` takes too long or too much memory, or ends the process; it names the file and, if known, the
            line.
    """
    if not hasattr(os, "fork"):
        return
    reading, writing = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # the copy takes no lock of other threads
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
    inside = re.search(rf'File "{re.escape(str(path))}", line (\d+)', said.decode(errors="replace"))
    raise InputError(f"{path}{f', line {inside[1]}' if inside else ''}: {_why(said, status)}")


def _read(pipe: int) -> bytes:
    """Read the pipe until its last end is closed, or for a little longer than the copy may live."""
    said, end = b"", time.monotonic() + MAX_WAIT_RATIO * USER_SECONDS + REPORT_SECONDS
    while select.select([pipe], [], [], max(0.0, end - time.monotonic()))[0] and (part := os.read(pipe, 65536)):
        said += part
    return said


def _perform(path: Path, work: Callable[[], object], writing: int) -> NoReturn:
    """Do the work in the copy."""
    with suppress(BaseException):
        # The output of the user's file must not appear twice, and nobody may be asked for input.
        quiet = os.open(os.devnull, os.O_RDWR)
        for descriptor in (0, 1, 2):
            os.dup2(quiet, descriptor)
        sys.stdout = sys.stderr = os.fdopen(quiet, "w")
        faulthandler.disable()
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)
        _limit_memory()
        faulthandler.register(signal.SIGPROF, file=writing, all_threads=False, chain=True)  # reports the line, ends
        signal.setitimer(signal.ITIMER_PROF, USER_SECONDS)
        faulthandler.dump_traceback_later(MAX_WAIT_RATIO * USER_SECONDS, exit=True, file=writing)
        outcome: BaseException | None = None
        try:
            work()
        except ArmdynError as error:
            outcome = error
        except BaseException as error:
            outcome = _fault(error, path)
        signal.setitimer(signal.ITIMER_PROF, 0.0)
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


def _why(said: bytes, status: int) -> str:
    if os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGPROF:
        return f"takes longer than {USER_SECONDS:g} s of processor time: do less there"
    if said.startswith(b"Timeout") or (os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGKILL):
        return f"waits for something, longer than {MAX_WAIT_RATIO * USER_SECONDS:g} s: do less there"
    if os.WIFSIGNALED(status):
        return f"ends the program by {signal.Signals(os.WTERMSIG(status)).name}: mend it"
    return f"ends the program, or takes more than {USER_MEMORY / MIB:g} MiB: mend it"
