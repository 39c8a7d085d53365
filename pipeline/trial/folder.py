"""Output folders of a trial: it writes to a temporary folder, whose files then replace the user's together.

A trial that is killed leaves what the user had as it was, and its recording in a folder ``unfinished-...`` beside it.
"""

import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from armdyn.errors import InputError
from armdyn.read_files import check_overwrite

UNFINISHED = "unfinished-"
LOCK = ".lock"
OF_THE_LAST = ("report.html", "swing.png", "swing.gif")
"""What is made from a recording: of an older one it must not stand beside a new one."""
OF_A_TRIAL = (*OF_THE_LAST, "model.toml", "trial.*", "experiment_*")
"""Patterns of all that a trial writes."""
MAX_PARALLEL_TRIALS = 1000
"""Trials at once that write beside each other."""


@contextmanager
def gather_files(out: Path | None) -> Iterator[Path]:
    """A temporary folder to write to; when the block ends or raises, its files replace those in `out` together.

    Args:
        out: folder of the user; None where nothing is kept.

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
    """Move the files; old reports are removed first, so that no report lies beside a recording that is not its own."""
    for name in OF_THE_LAST:
        (out / name).unlink(missing_ok=True)
    for file in sorted(folder.iterdir()):
        target = out / file.name
        # Links are followed, and the existing file's permissions are kept.
        target = target.resolve() if target.is_symlink() else target
        if target.is_file():
            with suppress(OSError):
                shutil.copymode(target, file)
        try:
            file.replace(target)
        except OSError:  # the link points to another disk
            shutil.move(file, target)
    folder.rmdir()


@contextmanager
def own_folder(
    given: Path | None, usual: Path, what: str = "trial", writes: Iterable[str] = OF_A_TRIAL
) -> Iterator[Path]:
    """Lock a folder, so that only this process writes to it until the block ends.

    Args:
        given: folder named by the user; None for the usual one, with a number where another trial writes to that.
        usual: default folder, such as ``out/trial``, then ``out/trial-2``.
        what: name of the writer, for the message.
        writes: patterns of the names of the written files.

    Raises:
        InputError: another trial writes to the given folder, it cannot be written to, or would lose what was read.
    """
    choices = (
        [given] if given else [usual, *(usual.with_name(f"{usual.name}-{n}") for n in range(2, MAX_PARALLEL_TRIALS))]
    )
    for folder in choices:
        with _refused(folder):
            folder.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0), 0o666)
        try:
            if _locked(descriptor):
                for old in (file for pattern in writes for file in folder.glob(pattern)):
                    check_overwrite(old)
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
