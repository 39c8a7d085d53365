"""Files that are either the old one or the whole new one, never half of it, and stay what their owner made of them.

Only a regular file is replaced, by a rename; a link stays and the file that it points to is replaced; mode and owner
are kept. Pipes and devices are written to.
"""

import os
import re
import secrets
import stat
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from armdyn.errors import InputError
from armdyn.read_files import may_replace, refuse_to_replace

_OPEN_FILE = re.compile(r"/(?:dev|proc/self)/fd/(\d+)")
_STANDARD = {"/dev/stdout": 1, "/dev/stderr": 2}
_TEMPORARY = ".armdyn-{}.tmp"
ABANDONED = 86400.0
"""Age from which a temporary file belongs to a program that was killed [s]: nobody writes to it any more."""


def write_text(path: Path, text: str) -> None:
    """Write `text` as UTF-8; see `replacing`."""
    with replacing(path) as file:
        file.write(text.encode("utf-8", errors="replace"))


def make_directory(path: Path) -> None:
    """Make a directory and those above it where they are missing.

    Raises:
        InputError: it cannot be made, or a file has its name.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise InputError(f"cannot make the directory {str(path)!r}: {error}; choose another place") from error


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """A file to write to, which takes the place of `path` when the block ends well.

    Args:
        path: of a file, which may be there or not; of a link to one; of a pipe or device, which is written to.

    Raises:
        InputError: the directory is missing, it or the file cannot be written to, the disk is full, or the command has
            read the old file; that is then as it was, and nothing is left beside it.
    """
    with _refusing(path):
        if is_stream(path):
            with _stream(path) as file:
                yield file
        else:
            with _beside(_replaceable(path)) as file:
                yield file


@contextmanager
def _refusing(path: Path) -> Iterator[None]:
    """What the system says against writing a file becomes an `InputError`."""
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}; choose another place") from error
    except ValueError as error:
        if "null" not in str(error):
            raise
        raise InputError(f"cannot write {str(path)!r}: a name holds no null character; choose another") from error


def _replaceable(path: Path) -> Path:
    """The file that a path leads to, whether or not it is there."""
    target = Path(os.path.realpath(path))
    if target.is_symlink():  # what is left of links in a circle
        raise OSError(0, "it is a link that leads back to itself")
    if target.is_dir():
        raise IsADirectoryError(0, "it is a directory")
    if target.exists() and not os.access(target, os.W_OK):
        raise PermissionError(0, "it is write-protected")
    refuse_to_replace(target)
    return target


@contextmanager
def replacing_both(first: Path, second: Path) -> Iterator[tuple[BinaryIO, BinaryIO]]:
    """Two files that belong together: both are the old ones or both the new ones; see `replacing`.

    Raises:
        InputError: as `replacing`; a disk that is full leaves both as they were.
    """
    with replacing(first) as one, replacing(second) as other:
        yield one, other
        for path, file in ((first, one), (second, other)):
            if not is_stream(path):
                file.flush()
                os.fsync(file.fileno())  # of both, before either takes its place


def is_stream(path: Path) -> bool:
    """Whether this is a pipe, a device or a file that is open already: it is written to and never replaced."""
    if _open_descriptor(path) is not None:
        return True
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def _open_descriptor(path: Path) -> int | None:
    name = os.path.normpath(path)
    match = _OPEN_FILE.fullmatch(name)
    return int(match[1]) if match else _STANDARD.get(name)


def _stream(path: Path) -> BinaryIO:
    descriptor = _open_descriptor(path)
    if descriptor is None:
        return path.open("wb", buffering=0)
    for standard in (sys.stdout, sys.stderr):  # what was printed before stands before
        with suppress(OSError, ValueError, AttributeError):
            standard.flush()
    return os.fdopen(os.dup(descriptor), "wb")


class GrowingFile:
    """A file that is of use before it is whole, such as a recording: a crash leaves what was written so far.

    Where there is no such file yet, it grows under its own name; else under another beside it, and takes the old one's
    place when it is finished: until then the old one stays whole, with everything that belongs to it.

    Args:
        path: as for `replacing`.

    Attributes:
        stream: to write to.

    Raises:
        InputError: it cannot be written to.
    """

    def __init__(self, path: Path) -> None:
        self._target = self._beside = None
        with _refusing(path):
            if is_stream(path):
                self.stream = _stream(path)
                return
            target = _replaceable(path)
            if target.exists():
                unfinished = f"{target.stem}-unfinished-{os.getpid()}-{secrets.token_hex(3)}{target.suffix}"
                self._target, self._beside = target, target.with_name(unfinished)
            self.stream = (self._beside or target).open("xb")
            may_replace(self._beside or target)

    def finish(self) -> None:
        """Close it and let it take its place.

        Raises:
            OSError: the disk is full, or it was moved away.
        """
        self.stream.close()
        if self._beside is not None and self._target is not None:
            with suppress(OSError):
                old = self._target.stat()
                self._beside.chmod(stat.S_IMODE(old.st_mode))
            self._beside.replace(self._target)
            may_replace(self._target)
            self._beside = None


@contextmanager
def _beside(target: Path) -> Iterator[BinaryIO]:
    old = target.stat() if target.exists() else None
    _remove_abandoned(target.parent)
    temporary = target.with_name(_TEMPORARY.format(f"{os.getpid()}-{secrets.token_hex(6)}"))
    mode = 0o666 if old is None else stat.S_IMODE(old.st_mode)
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_CLOEXEC", 0), mode & 0o777)
    try:
        with os.fdopen(descriptor, "wb") as file:
            yield file
            file.flush()
            if old is not None:
                with suppress(PermissionError):  # another's file that we may write: it becomes ours
                    os.fchown(descriptor, old.st_uid, old.st_gid)
                os.fchmod(descriptor, mode)  # whatever the umask, and after the owner, which clears bits
            os.fsync(descriptor)  # a disk that is full says so at the latest here
        temporary.replace(target)
        may_replace(target)
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def _remove_abandoned(directory: Path) -> None:
    """What programs that were killed have left of their files."""
    for left in directory.glob(_TEMPORARY.format("*")):
        with suppress(OSError):
            if time.time() - left.stat().st_mtime > ABANDONED:
                left.unlink()
