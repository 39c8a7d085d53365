"""Print to standard output and error without ever raising an exception, and report unexpected errors.

A stream may be full or closed, may lose its reader, or may lack characters. After an unexpected error the user gets a
message of one line, and a file with the details that a developer needs.
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

from armdyn.quoting import shell_quoted_command

REPORTED_PACKAGES = ("armdyn", "casadi", "pin", "mujoco", "numpy", "scipy")


def report_unexpected_error(error: BaseException) -> str:
    """Write a report of an unexpected error to a temporary file; returns a sentence with the error and the file."""
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
    versions = ", ".join(f"{name} {_version(name)}" for name in REPORTED_PACKAGES)
    return "\n".join(
        (
            f"command: {shell_quoted_command(*sys.argv[1:])}",
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


class NonRaisingStream(io.RawIOBase):
    """Binary output stream to a file descriptor that drops bytes which cannot be written, in place of raising.

    Attributes:
        problem: why bytes were dropped; None if none were dropped, or if the reader closed the pipe.
    """

    def __init__(self, descriptor: int) -> None:
        super().__init__()
        self._descriptor = descriptor
        self._gone = False
        self.problem: str | None = None

    def writable(self) -> bool:
        """True: the stream accepts bytes."""
        return True

    def fileno(self) -> int:
        """File descriptor of the stream."""
        return self._descriptor

    def isatty(self) -> bool:
        """Whether the stream is a terminal."""
        return not self._gone and os.isatty(self._descriptor)

    def write(self, data: Any) -> int | None:
        """Write bytes; returns the number of bytes written. After a failure all bytes are dropped and counted."""
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
def non_raising_streams() -> Iterator[Callable[[], str | None]]:
    """Replace standard output and error in the ``with`` block so that printing never raises an exception.

    An exception in a thread prints one line. Streams that a test has replaced are kept.

    Yields:
        A function that returns why output was dropped; None if none was dropped.
    """
    usual, kept = threading.excepthook, dict[str, tuple[TextIO | None, NonRaisingStream]]()
    for number, name in ((1, "stdout"), (2, "stderr")):
        before = getattr(sys, name)
        if before is not None and before is not getattr(sys, f"__{name}__"):
            continue
        if before is None:
            _occupy(number)
        raw = NonRaisingStream(number)
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
            print(f"armdyn: {report_unexpected_error(what.exc_value)}", file=sys.stderr)

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
