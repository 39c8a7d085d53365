"""Capture messages that C++ libraries print, in order to report them in an error message of one line."""

import io
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import IO

from urdf.robot import UrdfError

EXCEPTIONS_FROM_CPP = (ValueError, RuntimeError, LookupError, ArithmeticError)
"""Python exceptions that a C++ exception may be converted to."""
MAX_MESSAGE_CHARACTERS = 200
"""Largest number of characters of a library's message that are shown."""


@dataclass
class CapturedOutput:
    """Output that `captured_output` captured, as one line; filled when its ``with`` block ends."""

    text: str = ""


@contextmanager
def captured_output() -> Iterator[CapturedOutput]:
    """Capture everything that this process, C++ code included, prints during the ``with`` block."""
    said, kept = CapturedOutput(), []
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):  # closed, or none at all
            stream.flush()
    with _scratch_file() as file:
        for descriptor in (1, 2):
            with suppress(OSError):  # closed: there is nothing to print to
                kept.append((os.dup(descriptor), descriptor))
                os.dup2(file.fileno(), descriptor)
        try:
            yield said
        finally:
            for copy, descriptor in kept:
                os.dup2(copy, descriptor)
                os.close(copy)
            file.seek(0)
            said.text = " ".join(file.read(100 * MAX_MESSAGE_CHARACTERS).decode("utf-8", errors="replace").split())[
                :MAX_MESSAGE_CHARACTERS
            ]


def _scratch_file() -> io.FileIO | IO[bytes]:
    """A file in memory, because a disk may be full; on systems without such files one in a temporary directory."""
    return io.FileIO(os.memfd_create("said"), "r+") if hasattr(os, "memfd_create") else tempfile.TemporaryFile()


@contextmanager
def library_errors(what: str, remedy: str) -> Iterator[None]:
    """Convert the C++ exceptions of a library, and what it prints, during the ``with`` block to a `UrdfError`.

    Args:
        what: beginning of the message: what failed.
        remedy: end of the message: what the user can do.

    Raises:
        UrdfError: the library failed; the message contains the library's own message.
    """
    said = CapturedOutput()
    try:
        with captured_output() as said:
            yield
    except EXCEPTIONS_FROM_CPP as error:
        text = str(error) if "message:" in str(error) or not said.text else said.text
        text = text.partition("message:")[2] or text
        reason = " ".join(text.partition("Hint")[0].split())[:MAX_MESSAGE_CHARACTERS]
        raise UrdfError(f"{what} ({reason}); {remedy}") from error
