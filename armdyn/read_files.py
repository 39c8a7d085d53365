"""Keep a list of the files that a command has read, so that no output overwrites one of them.

A user who chooses an output file cannot know every file that a command reads, such as the URDF that a model names.
Python calls an audit hook for every file that is opened; files opened by other languages are added by `register_input`.
Only commands keep the list: a user's own program may overwrite what it has read.

The same hook prevents a command from waiting for ever at a named pipe.
"""

import errno
import os
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from armdyn.errors import InputError


class _Opened:
    """The files that one command has read, and those of them that may be overwritten."""

    def __init__(self) -> None:
        self.paths: set[str] = set()
        self.free: set[tuple[int, int]] = set()


_opened: _Opened | None = None
_hooked = False


def _hear(event: str, arguments: tuple[Any, ...]) -> None:
    if event != "open" or _opened is None:
        return
    path, _, flags = arguments
    if isinstance(path, str | bytes) and not (flags or 0) & (os.O_WRONLY | os.O_RDWR):
        with suppress(OSError, ValueError):  # the working directory is gone; a name with a null character
            _opened.paths.add(str(Path(os.fsdecode(path)).absolute()))
        if not os.fsdecode(path).startswith(("/dev/", "/proc/")):
            _refuse_named_pipe(path)


def _refuse_named_pipe(path: str | bytes) -> None:
    """Raise an `OSError` for a named pipe: opening it waits until another program opens it."""
    try:
        named = stat.S_ISFIFO(os.stat(path).st_mode)  # noqa: PTH116 called for every file that is opened
    except (OSError, ValueError):  # whoever opens it will say so
        return
    if named:
        raise OSError(errno.EINVAL, "it is a named pipe, which may never be written to; give a file", path)


@contextmanager
def refuse_overwriting_inputs() -> Iterator[None]:
    """Context manager: refuse to overwrite any file that was read in the block, and to open a named pipe."""
    global _opened, _hooked
    if not _hooked:
        sys.addaudithook(_hear)
        _hooked = True
    before, _opened = _opened, _Opened()
    try:
        yield
    finally:
        _opened = before


def register_input(path: Path) -> None:
    """Register as an input a file that is read by a library in another language than Python."""
    sys.audit("open", str(path), "rb", os.O_RDONLY)


def allow_overwrite(path: Path) -> None:
    """Allow a command to overwrite a file although it has read it, such as a file that it has written itself."""
    identity = _identity(path)
    if _opened is not None and identity is not None:
        _opened.free.add(identity)


def check_not_input(path: Path) -> None:
    """Check that a command may write to a path: a file that it has read, also under another name, is refused.

    Raises:
        InputError: the file was read.
    """
    identity = _identity(path)
    if _opened is None or identity is None or identity in _opened.free:
        return
    if any(identity == _identity(read) for read in tuple(_opened.paths)):
        raise InputError(f"{path} is an input, which was read: choose another file to write")


def _identity(path: Path | str) -> tuple[int, int] | None:
    """Device and number of a file, which are the same for all its names; None where there is no file."""
    with suppress(OSError, ValueError):
        found = Path(path).stat()
        return found.st_dev, found.st_ino
    return None
