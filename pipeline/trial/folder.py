"""Output folders of a trial: it writes to a temporary folder, whose files are moved to the user's folder at the end.

A killed trial leaves the user's files unchanged, and its recording in a folder ``unfinished-...`` in the user's folder.
"""

import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from armdyn import atomic
from armdyn.errors import InputError
from armdyn.read_files import check_not_input

UNFINISHED_FOLDER_PREFIX = "unfinished-"
"""Beginning of the name of a trial's temporary folder."""
LOCK_FILE_NAME = ".lock"
"""Name of the file that a process locks while it writes to a folder."""
REPORT_AND_PICTURE_FILES = ("report.html", "swing.png", "swing.gif")
"""Files that a trial makes from its recording; those of an older recording are removed."""
TRIAL_FILE_PATTERNS = (*REPORT_AND_PICTURE_FILES, "model.toml", "trial.*", "experiment_*")
"""Name patterns of all files that a trial writes."""
MAX_PARALLEL_TRIALS = 1000
"""Largest number of trials that can run at the same time with the default folder."""


@contextmanager
def temporary_output_folder(out: Path | None) -> Iterator[Path]:
    """A temporary folder to write to; at the end of the ``with`` block its files are moved to the folder `out`.

    The files are moved after an exception, too.

    Args:
        out: folder of the user; None to keep no files.

    Raises:
        InputError: `out` cannot be written to.
    """
    if out is None:
        with tempfile.TemporaryDirectory() as scratch:
            yield Path(scratch)
        return
    with _refused(out):
        out.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=UNFINISHED_FOLDER_PREFIX, dir=out))
    try:
        yield folder
    finally:
        with _refused(out):
            _move(folder, out)


def _move(folder: Path, out: Path) -> None:
    """Move the files; old reports are removed first, so that no report lies beside a recording that is not its own."""
    files = sorted(folder.iterdir())
    for name in {*REPORT_AND_PICTURE_FILES, *(file.name for file in files)}:
        check_not_input(out / name)  # all of them before the first is moved
    for name in REPORT_AND_PICTURE_FILES:
        (out / name).unlink(missing_ok=True)
    for file in files:
        atomic.move_file(file, out / file.name)
    folder.rmdir()


@contextmanager
def locked_folder(
    given: Path | None, usual: Path, what: str = "trial", writes: Iterable[str] = TRIAL_FILE_PATTERNS
) -> Iterator[Path]:
    """Lock a folder, so that only this process writes to it until the end of the ``with`` block.

    Args:
        given: folder named by the user; None for the default folder, or a numbered one while another trial uses that.
        usual: default folder, such as ``out/trial``; the numbered ones are ``out/trial-2`` and so on.
        what: name of the task that writes, for the error message.
        writes: name patterns of the files to write.

    Raises:
        InputError: another process writes to the given folder, the folder cannot be written to, or an input file of
            this command would be replaced.
    """
    choices = (
        [given] if given else [usual, *(usual.with_name(f"{usual.name}-{n}") for n in range(2, MAX_PARALLEL_TRIALS))]
    )
    for folder in choices:
        with _refused(folder):
            folder.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(folder / LOCK_FILE_NAME, os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0), 0o666)
        try:
            if _locked(descriptor):
                for old in (file for pattern in writes for file in folder.glob(pattern)):
                    check_not_input(old)
                yield folder
                return
        finally:
            os.close(descriptor)  # closing the file also unlocks it, as the end of the process does
    raise InputError(f"another {what} writes to {choices[0]}: wait for it, or choose another folder")


def _locked(descriptor: int) -> bool:
    try:
        import fcntl
    except ImportError:  # on Windows two trials in one folder are not separated
        return True
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # the file system has no locks, as on some network drives
        return True
    return True


@contextmanager
def _refused(out: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot write to {out}: {error.strerror or error}; choose another directory") from error
