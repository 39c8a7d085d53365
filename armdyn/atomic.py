"""Files that are either the old one or the whole new one, never half of it."""

import os
from pathlib import Path

from armdyn.errors import InputError


def write_text(path: Path, text: str) -> None:
    """Write `text` to `path` in one step: a temporary file beside it, then a rename.

    Raises:
        InputError: the directory is missing or cannot be written to.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        if path.exists() and not path.is_file():  # a device or a pipe is written to, not replaced
            path.write_text(text, encoding="utf-8", newline="")
            return
        try:
            temporary.write_text(text, encoding="utf-8", newline="")
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}; choose another place") from error
