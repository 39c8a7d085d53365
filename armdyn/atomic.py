"""The only place that writes files: also after a crash, a file has its old or its new content, never a part of it.

A regular file is replaced by renaming a complete new one, which gets its mode and owner. A link stays a link: the file
that it points to is replaced. Pipes and devices are written to directly. Recordings, logs and journals, which are
useful before they are complete, grow (`CrashSafeGrowingFile`). No file that the command has read is overwritten, under
whatever name: that is checked at the start, and again before the old file is replaced.
"""

import io
import os
import re
import secrets
import shutil
import stat
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from armdyn.errors import InputError
from armdyn.read_files import allow_overwrite, check_not_input

_OPEN_FILE = re.compile(r"/(?:dev|proc/self)/fd/(\d+)")
_STANDARD = {"/dev/stdout": 1, "/dev/stderr": 2}
_TEMPORARY = ".armdyn-{}.tmp"
ABANDONED_SECONDS = 86400.0
"""Age, s, of a temporary file beyond which it is removed: the program that wrote it must have been killed."""


def write_text(path: Path, text: str) -> None:
    """Write a text as UTF-8: even after a crash, the file has its old or its new content; see `replace_file`."""
    with replace_file(path) as file:
        file.write(text.encode("utf-8", errors="replace"))


def make_directory(path: Path) -> None:
    """Make a directory, and the missing directories above it; an existing directory is not an error.

    Raises:
        InputError: the directory cannot be made, or a file has its name.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise InputError(f"cannot make the directory {str(path)!r}: {why}; choose another place") from error


@contextmanager
def replace_file(path: Path) -> Iterator[BinaryIO]:
    """Context manager: open a new file for writing, which replaces `path` when the block ends without an error.

    Args:
        path: a file, which may exist or not, a link to one, or a pipe or device, which is written to.

    Raises:
        InputError: the directory is missing, the directory or the file is not writable, the disk is full, or the
            command has read the old file. The old file is then unchanged, and no temporary file remains.
    """
    with _refusing(path):
        if is_stream(path):
            with io.BufferedWriter(_stream(path)) as file:
                yield file
        else:
            with _beside(_replaceable(path)) as file:
                yield file


@contextmanager
def _refusing(path: Path) -> Iterator[None]:
    """Turn the system's errors of writing a file into an `InputError`."""
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}; choose another place") from error
    except ValueError as error:
        if "null" not in str(error):
            raise
        raise InputError(f"cannot write {str(path)!r}: a name holds no null character; choose another") from error


def _replaceable(path: Path) -> Path:
    """The file that a path leads to, which may not exist."""
    target = Path(os.path.realpath(path))
    if target.is_symlink():  # what is left of links in a circle
        raise OSError(0, "it is a link that leads back to itself")
    if target.is_dir():
        raise IsADirectoryError(0, "it is a directory")
    if target.exists() and not os.access(target, os.W_OK):
        raise PermissionError(0, "it is write-protected")
    check_not_input(target)
    return target


@contextmanager
def replace_two_files(first: Path, second: Path) -> Iterator[tuple[BinaryIO, BinaryIO]]:
    """Context manager: open two new files that belong together, of which both or none replace the old ones.

    Raises:
        InputError: one of the files cannot be written (see `replace_file`); both old files are then unchanged.
    """
    with replace_file(first) as one, replace_file(second) as other:
        yield one, other
        for path, file in ((first, one), (second, other)):
            if not is_stream(path):
                file.flush()
                os.fsync(file.fileno())  # of both, before either takes its place


def is_stream(path: Path) -> bool:
    """Whether a path is a pipe, a device or an open file, which is written to directly and never replaced."""
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


def _stream(path: Path) -> io.FileIO:
    descriptor = _open_descriptor(path)
    if descriptor is None:
        return path.open("wb", buffering=0)
    for standard in (sys.stdout, sys.stderr):  # earlier output comes first
        with suppress(OSError, ValueError, AttributeError):
            standard.flush()
    return os.fdopen(os.dup(descriptor), "wb", buffering=0)


def move_file(source: Path, target: Path) -> None:
    """Move a file to a place, where it replaces a file and gets its mode; a link at `target` stays a link.

    Raises:
        InputError: `target` cannot be written to, or the command has read the old file there.
    """
    with _refusing(target):
        place = _replaceable(target)
        if place.is_file():
            with suppress(OSError):
                shutil.copymode(place, source)
        try:
            source.replace(place)
        except OSError:  # on another disk
            with source.open("rb") as old, replace_file(place) as new:
                shutil.copyfileobj(old, new)
            source.unlink()
        allow_overwrite(place)


class CrashSafeGrowingFile:
    """A file that is useful before it is complete, such as a recording: after a crash it holds all that was written.

    A new file is written under its own name. Where an old file has this name, the new one is written beside it under
    another name, and replaces the old one in `finish`. A full disk raises no error: `failure` then says what happened,
    and nothing more is written, because neither a robot nor its watch may stop for a log.

    Args:
        path: path of the file; see `replace_file`.
        append: whether to append to an old file, instead of replacing it.

    Attributes:
        stream: stream for a library to write to; its errors are passed to `fail`.
        failure: why the file could not be written any further; None while it can.

    Raises:
        InputError: the file cannot be written to.
    """

    def __init__(self, path: Path, *, append: bool = False) -> None:
        self.failure: str | None = None
        self._name, self._target, self._beside = path.name, path, path
        with _refusing(path):
            if is_stream(path):
                self._raw: io.RawIOBase = _stream(path)
            else:
                self._target = self._beside = _replaceable(path)
                if self._target.exists() and not append:
                    unfinished = f"{path.stem}-unfinished-{os.getpid()}-{secrets.token_hex(3)}{path.suffix}"
                    self._beside = self._target.with_name(unfinished)
                self._raw = self._beside.open("ab" if append else "xb", buffering=0)
                allow_overwrite(self._beside)
        self.stream = io.BufferedWriter(self._raw)

    def write(self, text: str, *, durable: bool = False) -> None:
        """Append a text as UTF-8; of a text that does not fit on the disk, nothing is written.

        Args:
            text: complete lines.
            durable: whether to wait until the disk has stored them.
        """
        if self.failure is not None:
            return
        before = None
        try:
            before = self._raw.tell() if self._raw.seekable() else None
            left = memoryview(text.encode("utf-8", errors="replace"))
            while left:
                left = left[self._raw.write(left) or 0 :]
            if durable:
                os.fsync(self._raw.fileno())
        except OSError as error:
            self.fail(error)
            if before is not None:
                with suppress(OSError):
                    self._raw.truncate(before)

    def fail(self, error: OSError) -> None:
        """Write nothing more because of an error, which `failure` then describes."""
        where = f"; what came before is in {self._beside}" if self._beside != self._target else ""
        self.failure = self.failure or (
            f"{self._name} could not be written any further: {error.strerror or error}; make room, or choose another "
            f"place{where}"
        )

    def finish(self) -> None:
        """Close the file; where an old file has its name, the new one replaces it, unless `failure` is set."""
        try:
            self.stream.close()
        except OSError as error:  # the disk is full
            self.fail(error)
        if self.failure is not None or self._beside == self._target:
            return
        try:
            check_not_input(self._target)  # it may have been read after this file was opened
            with suppress(OSError):
                self._beside.chmod(stat.S_IMODE(self._target.stat().st_mode))
            self._beside.replace(self._target)
            allow_overwrite(self._target)
            self._beside = self._target
        except InputError as error:
            self.failure = f"{error}; what was written is in {self._beside}"
        except OSError as error:  # the file was moved away
            self.fail(error)


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
        check_not_input(target)  # it may have been read since the beginning
        temporary.replace(target)
        allow_overwrite(target)
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def _remove_abandoned(directory: Path) -> None:
    """Remove temporary files of programs that were killed."""
    for left in directory.glob(_TEMPORARY.format("*")):
        with suppress(OSError):
            if time.time() - left.stat().st_mtime > ABANDONED_SECONDS:
                left.unlink()
