"""Standard output and error that never raise, and what is said of errors that nobody has foreseen.

A stream may be full, closed, with a reader that ends, in any encoding. Of what was not foreseen the user gets one line,
and a file with everything that whoever mends it needs.
"""

import errno
import io
import os
import platform
import shlex
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from importlib import metadata
from typing import Any, TextIO

PACKAGES = ("armdyn", "casadi", "pin", "mujoco", "numpy", "scipy")


def report_unforeseen(error: BaseException) -> str:
    """Write the report; a sentence that says what was raised and where the report is."""
    what = f"{type(error).__name__}{': ' if str(error) else ''}{' '.join(str(error).split())[:200]}"
    try:
        with tempfile.NamedTemporaryFile(
            "w", prefix="armdyn-report-", suffix=".txt", delete=False, encoding="utf-8", errors="replace"
        ) as file:
            file.write(_report(error))
        place = f"please send {file.name}"
    except OSError:  # a full disk must not hide what happened
        frames = traceback.extract_tb(error.__traceback__)
        place = f"it came from {frames[-1].filename}, line {frames[-1].lineno}" if frames else "nothing more is known"
    return f"{what}: this was not foreseen, it is a mistake of armdyn and not yours; {place}"


def _report(error: BaseException) -> str:
    versions = ", ".join(f"{name} {_version(name)}" for name in PACKAGES)
    return "\n".join(
        (
            f"command: {shlex.join(['armdyn', *sys.argv[1:]])}",
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
    """The bytes of a standard stream; what cannot be written is dropped.

    Attributes:
        problem: why bytes were dropped; None where they were not, or where the reader simply has seen enough.
    """

    def __init__(self, descriptor: int) -> None:
        super().__init__()
        self._descriptor = descriptor
        self._gone = False
        self.problem: str | None = None

    def writable(self) -> bool:
        """It is."""
        return True

    def fileno(self) -> int:
        """Of the stream."""
        return self._descriptor

    def isatty(self) -> bool:
        """Whether a person reads it."""
        return not self._gone and os.isatty(self._descriptor)

    def write(self, data: Any) -> int | None:
        """Write what can be written; says that everything was."""
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
    """Let nothing that is printed raise an error, and let a thread that fails print one line.

    Standard streams are replaced where they are files, not where a test has put something in their place.

    Yields:
        A function that says why something of standard output was dropped; None where nothing was.
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
    """A standard stream that is closed leads nowhere, rather than into the next file that is opened."""
    try:
        os.fstat(number)
    except OSError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        if nowhere != number:
            os.dup2(nowhere, number)
            os.close(nowhere)
