"""Standard output and error that never raise, and reports of unforeseen errors.

A stream may be full or closed, may lose its reader, and may have any encoding. After an unforeseen error the user gets
one line, and a file with all facts that a developer needs.
"""

import errno
import io
import os
import platform
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from importlib import metadata
from typing import Any, TextIO

from armdyn.quoting import command_text

PACKAGES = ("armdyn", "casadi", "pin", "mujoco", "numpy", "scipy")


def report_unforeseen(error: BaseException) -> str:
    """Write the report of an unforeseen error; returns a sentence that names the error and the report's file."""
    what = f"{type(error).__name__}{': ' if str(error) else ''}{' '.join(str(error).split())[:200]}"
    try:
        with tempfile.NamedTemporaryFile(
            "w", prefix="armdyn-report-", suffix=".txt", delete=False, encoding="utf-8", errors="replace"
        ) as file:
            file.write(_report(error))
        place = f"please send {file.name}"
    except OSError:  # a full disk must not hide the error
        frames = traceback.extract_tb(error.__traceback__)
        place = f"it came from {frames[-1].filename}, line {frames[-1].lineno}" if frames else "nothing more is known"
    return f"{what}: this was not foreseen, it is a mistake of armdyn and not yours; {place}"


def _report(error: BaseException) -> str:
    versions = ", ".join(f"{name} {_version(name)}" for name in PACKAGES)
    return "\n".join(
        (
            f"command: {command_text(*sys.argv[1:])}",
            f"time: {datetime.now().astimezone().isoformat(timespec='seconds')}",
            f"system: {platform.platform()}, Python {platform.python_version()}",
            f"versions: {versions}",
            "",
            *traceback.format_exception(error),
        )
    )


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "not installed"


class Tolerant(io.RawIOBase):
    """Binary output to a standard stream; bytes that cannot be written are dropped.

    Attributes:
        problem: why bytes were dropped; None where none were, or where the reader simply closed the pipe.
    """

    def __init__(self, descriptor: int) -> None:
        super().__init__()
        self._descriptor = descriptor
        self._gone = False
        self.problem: str | None = None

    def writable(self) -> bool:
        """Always True: the stream accepts bytes."""
        return True

    def fileno(self) -> int:
        """File descriptor of the stream."""
        return self._descriptor

    def isatty(self) -> bool:
        """Whether the stream is a terminal."""
        return not self._gone and os.isatty(self._descriptor)

    def write(self, data: Any) -> int | None:
        """Write bytes; returns the number written, which is that of all bytes once the stream has failed."""
        if not self._gone:
            try:
                return os.write(self._descriptor, data)
            except BlockingIOError:
                return None
            except OSError as error:
                self._gone = True
                if error.errno != errno.EPIPE:
                    self.problem = error.strerror or str(error)
        return len(data)


@contextmanager
def tolerant_streams() -> Iterator[Callable[[], str | None]]:
    """Replace the standard streams so that printing never raises, and a failing thread prints one line.

    Standard streams are replaced where they are files, not where a test has put something in their place.

    Yields:
        A function that returns why output was dropped; None where none was dropped.
    """
    usual, kept = threading.excepthook, dict[str, tuple[TextIO | None, Tolerant]]()
    for number, name in ((1, "stdout"), (2, "stderr")):
        before = getattr(sys, name)
        if before is not None and before is not getattr(sys, f"__{name}__"):
            continue
        if before is None:
            _occupy(number)
        raw = Tolerant(number)
        encoding = getattr(before, "encoding", None) or "utf-8"
        lines = number == 2 or raw.isatty()
        setattr(sys, name, io.TextIOWrapper(io.BufferedWriter(raw), encoding, errors="replace", line_buffering=lines))
        kept[name] = before, raw

    def problem() -> str | None:
        with suppress(OSError, ValueError, AttributeError):
            sys.stdout.flush()
        return kept["stdout"][1].problem if "stdout" in kept else None

    def report(what: threading.ExceptHookArgs) -> None:
        if what.exc_value is not None and not isinstance(what.exc_value, SystemExit):
            print(f"armdyn: {report_unforeseen(what.exc_value)}", file=sys.stderr)

    threading.excepthook = report
    try:
        yield problem
    finally:
        threading.excepthook = usual
        for name, (before, _) in kept.items():
            with suppress(OSError, ValueError, AttributeError):
                getattr(sys, name).flush()
            setattr(sys, name, before)


def _occupy(number: int) -> None:
    """Connect a closed standard stream to the null device, so that no other file takes its descriptor."""
    try:
        os.fstat(number)
    except OSError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        if nowhere != number:
            os.dup2(nowhere, number)
            os.close(nowhere)
