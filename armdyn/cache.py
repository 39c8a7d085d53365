"""The user's private folder for results that are slow to compute; no other user can write to it.

Its files are loaded as machine code, so a file that another user could have written is never used.
"""

import os
import re
import shutil
import stat
import tempfile
from atexit import register
from contextlib import suppress
from functools import cache
from pathlib import Path

OTHERS_WRITE_MODE = stat.S_IWGRP | stat.S_IWOTH
"""Bits of a file's mode that allow other users to write to it."""
MAX_ENTRY_NAME_LENGTH = 100
"""Largest number of characters in the name of a cached file, before its hash; file systems allow 255 in all."""


def cache_directory() -> Path:
    """Directory for cached results: the user's private one, or, where that cannot be used, one for this process.

    The private one is ``$ARMDYN_CACHE`` if set, else ``$XDG_CACHE_HOME/armdyn``, else ``~/.cache/armdyn``.
    """
    return private_directory() or _passing_directory()


def private_directory() -> Path | None:
    """The user's cache directory, created if absent; None where it is not writable, or other users can write to it.

    A directory of the user in the default place is closed to other users; the mode of one that ``$ARMDYN_CACHE`` names
    is not changed.
    """
    chosen = os.environ.get("ARMDYN_CACHE")
    try:
        root = Path(chosen) if chosen else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "armdyn"
        root.mkdir(mode=0o700, parents=True, exist_ok=True)
        directory = root.resolve(strict=True)
        found = directory.stat()
        if not chosen and _is_ours(found) and found.st_mode & OTHERS_WRITE_MODE:
            directory.chmod(stat.S_IMODE(found.st_mode) & ~OTHERS_WRITE_MODE)
            found = directory.stat()
    except (OSError, RuntimeError, ValueError):  # no home, no place, links in a circle, a null character
        return None
    private = _is_ours(found) and not found.st_mode & OTHERS_WRITE_MODE
    return directory if private and os.access(directory, os.R_OK | os.W_OK | os.X_OK) else None


def is_private(file: Path) -> bool:
    """Whether a path is a regular file (no link) that belongs to the user and that no other user can write to."""
    try:
        found = file.lstat()
    except OSError:
        return False
    return stat.S_ISREG(found.st_mode) and _is_ours(found) and not found.st_mode & OTHERS_WRITE_MODE


def entry_name(name: str) -> str:
    """Turn a name from a file, such as a robot's, into a part of a file name: letters, digits, ``_`` and ``-``."""
    return re.sub(r"[^A-Za-z0-9_-]", "_", name)[:MAX_ENTRY_NAME_LENGTH] or "_"


def _is_ours(found: os.stat_result) -> bool:
    return not hasattr(os, "geteuid") or found.st_uid == os.geteuid()


@cache
def _passing_directory() -> Path:
    directory = Path(tempfile.mkdtemp(prefix="armdyn-"))

    def remove() -> None:
        with suppress(OSError):
            shutil.rmtree(directory)

    register(remove)
    return directory
