"""Capture the printed messages of C++ libraries, for our own message of one line."""

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

from urdf.robot import UrdfError

CPP_ERRORS = (ValueError, RuntimeError, LookupError, ArithmeticError)
"""What Python sees of a C++ exception, by its kind."""
MAX_SHOWN_CHARACTERS = 200
"""Characters of it that fit into a line."""


@dataclass
class Captured:
    """Captured output in one line; complete when the block has ended."""

    text: str = ""


@contextmanager
def captured_output() -> Iterator[Captured]:
    """Capture all that the process prints on standard output and error in the block, as one line."""
    said, kept = Captured(), []
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):  # closed, or none at all
            stream.flush()
    with tempfile.TemporaryFile() as file:
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
            said.text = " ".join(file.read(100 * MAX_SHOWN_CHARACTERS).decode("utf-8", errors="replace").split())[
                :MAX_SHOWN_CHARACTERS
            ]


@contextmanager
def library_errors(what: str, remedy: str) -> Iterator[None]:
    """Run a library in the block without printing; its messages become part of the error where it fails.

    Raises:
        UrdfError: `what` is wrong, the library's own words without where in its source it noticed, and the remedy.
    """
    said = Captured()
    try:
        with captured_output() as said:
            yield
    except CPP_ERRORS as error:
        text = str(error) if "message:" in str(error) or not said.text else said.text
        text = text.partition("message:")[2] or text
        reason = " ".join(text.partition("Hint")[0].split())[:MAX_SHOWN_CHARACTERS]
        raise UrdfError(f"{what} ({reason}); {remedy}") from error
