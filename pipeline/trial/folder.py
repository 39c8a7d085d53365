"""Where a trial writes: into a folder of its own, and from there into the user's in one go, when everything is there.

A trial that is killed leaves what the user had as it was, and its recording in a folder ``unfinished-...`` beside it.
"""

import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from armdyn.errors import InputError
from armdyn.read_files import refuse_to_replace

UNFINISHED = "unfinished-"
LOCK = ".lock"
OF_THE_LAST = ("report.html", "swing.png", "swing.gif")
"""What is made from a recording: of an older one it must not stand beside a new one."""
OF_A_TRIAL = (*OF_THE_LAST, "model.toml", "trial.*", "experiment_*")
"""Patterns of all that a trial writes."""
MOST = 1000
"""Trials at once that write beside each other."""


@contextmanager
def gather_files(out: Path | None) -> Iterator[Path]:
    """A folder to write to; at the end, also by an exception, its files take the place of those in `out` together.

    Args:
        out: None where nothing is kept.

    Raises:
        InputError: `out` cannot be written to.
    """
    if out is None:
        with tempfile.TemporaryDirectory() as scratch:
            yield Path(scratch)
        return
    with _refused(out):
        out.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=UNFINISHED, dir=out))
    try:
        yield folder
    finally:
        with _refused(out):
            _move(folder, out)


def _move(folder: Path, out: Path) -> None:
    """First goes what was made from the last recording: no report may stand beside another recording than its own."""
    for name in OF_THE_LAST:
        (out / name).unlink(missing_ok=True)
    for file in sorted(folder.iterdir()):
        target = out / file.name
        # Through a link, and with the rights of the file that is there.
        target = target.resolve() if target.is_symlink() else target
        if target.is_file():
            with suppress(OSError):
                shutil.copymode(target, file)
        try:
            file.replace(target)
        except OSError:  # the link leads to another disk
            shutil.move(file, target)
    folder.rmdir()


@contextmanager
def own_folder(
    given: Path | None, usual: Path, what: str = "trial", writes: Iterable[str] = OF_A_TRIAL
) -> Iterator[Path]:
    """The folder that this process alone writes to, until the block ends.

    Args:
        given: by the user; None for the usual one, or where another trial writes there, that with a number.
        usual: such as ``out/trial``, then ``out/trial-2``.
        what: writes there, for the message.
        writes: patterns of the names of what it writes.

    Raises:
        InputError: another trial writes to the given folder, it cannot be written to, or would lose what was read.
    """
    choices = [given] if given else [usual, *(usual.with_name(f"{usual.name}-{n}") for n in range(2, MOST))]
    for folder in choices:
        with _refused(folder):
            folder.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0), 0o666)
        try:
            if _locked(descriptor):
                for old in (file for pattern in writes for file in folder.glob(pattern)):
                    refuse_to_replace(old)
                yield folder
                return
        finally:
            os.close(descriptor)  # which also unlocks, as the end of the process does
    raise InputError(f"another {what} writes to {choices[0]}: wait for it, or choose another folder")


def _locked(descriptor: int) -> bool:
    try:
        import fcntl
    except ImportError:  # Windows: two trials in one folder are not kept apart
        return True
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks, such as some network drives
        return True
    return True


@contextmanager
def _refused(out: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot write to {out}: {error.strerror or error}; choose another directory") from error
