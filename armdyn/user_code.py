"""Run a user's Python file if the user knows of it, and report whatever it raises in one line.

A file of Python that a model file or a batch names runs without a question if it lies in the folder of the file that
names it, or below. Any other is run only after the user has allowed it; that is remembered by the file's content.
"""

import hashlib
import importlib.util
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import ModuleType
from typing import ClassVar

from armdyn import atomic
from armdyn.cache import is_private, private_directory
from armdyn.errors import MAX_SHOWN_MESSAGE_LENGTH, ArmdynError, InputError
from urdf.bounds import MAX_TEXT_FILE_BYTES, MIB

TRUST_OPTION = "--trust-code"
"""Option of every command with which the user allows the Python files outside their folders that it would run."""
TRUSTED_FOLDER = "trusted"
"""Folder in the user's private one with an empty file per allowed Python file, named by the digest of its content."""


class _Trust:
    """What this process may run."""

    everything = False
    digests: ClassVar[set[str]] = set()


@contextmanager
def trusting_code() -> Iterator[None]:
    """Context manager: allow, for good, every Python file that a model or a batch names in the block."""
    before, _Trust.everything = _Trust.everything, True
    try:
        yield
    finally:
        _Trust.everything = before


def allow_code(path: Path) -> None:
    """Remember that the user has named a Python file; another content of the file is not allowed by this."""
    if (digest := _digest(path)) in _Trust.digests:
        return
    _Trust.digests.add(digest)
    folder = private_directory()
    if folder is not None:
        with suppress(OSError, InputError):  # a full disk: the user is asked again
            (folder / TRUSTED_FOLDER).mkdir(mode=0o700, exist_ok=True)
            atomic.write_text(folder / TRUSTED_FOLDER / digest, "")


def check_code(path: Path, named_in: Path) -> None:
    """Check that a Python file may be run that a file in the folder `named_in` names.

    Raises:
        InputError: it lies outside the folder, and the user has not allowed it.
    """
    if path.resolve().is_relative_to(named_in.resolve()) or not path.is_file():
        return
    folder, digest = private_directory(), _digest(path)
    if digest in _Trust.digests or (folder is not None and is_private(folder / TRUSTED_FOLDER / digest)):
        return
    if not _Trust.everything:
        raise InputError(
            f"{path} is Python code from outside the folder {named_in}: read it, and if you trust it, type the command "
            f"again with {TRUST_OPTION}"
        )
    allow_code(path)


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.sha256(file.read(MAX_TEXT_FILE_BYTES + 1)).hexdigest()


def load_module(path: Path, holds: str) -> ModuleType:
    """Run a user's Python file and return it as a module; it may do anything that a Python program may do.

    Args:
        path: path of the file.
        holds: what the file should contain, such as ``"effects"``.

    Raises:
        InputError: the file cannot be read or run.
    """
    wanted = f"give the Python file with your {holds}"
    if path.is_dir():
        raise InputError(f"{path} is a directory: {wanted}")
    if not path.is_file():
        raise InputError(f"{path}: no such file: {wanted}")
    if path.stat().st_size > MAX_TEXT_FILE_BYTES:
        raise InputError(f"{path}: is larger than {MAX_TEXT_FILE_BYTES / MIB:g} MiB: {wanted}")
    spec = importlib.util.spec_from_file_location(f"armdyn_user_{holds}_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path}: is not a Python file: give one that ends in .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    with user_code_errors(path), warnings.catch_warnings():
        warnings.simplefilter("ignore", SyntaxWarning)  # style warnings are the user's own affair
        spec.loader.exec_module(module)
    return module


@contextmanager
def user_code_errors(path: Path) -> Iterator[None]:
    """Context manager: turn any exception of a user's file into an `InputError` with the file, line and cause."""
    try:
        yield
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        if isinstance(error, SystemExit):
            said = "ends the program: remove sys.exit or exit"
        else:
            text = str(error) if isinstance(error, ArmdynError) else f"{type(error).__name__}: {error}"
            said = " ".join(text.split())
        placed = said if said.startswith(str(path)) else f"{error_line(error, path)}: {said[:MAX_SHOWN_MESSAGE_LENGTH]}"
        raise InputError(placed) from error


def error_line(error: BaseException | None, path: Path) -> str:
    """Text ``"<path>, line <number>"`` of the line in a file where an exception arose; else the path alone."""
    line = error.lineno if isinstance(error, SyntaxError) else None
    trace = error.__traceback__ if error is not None else None
    while trace is not None:
        if Path(trace.tb_frame.f_code.co_filename) == path.absolute():
            line = trace.tb_lineno
        trace = trace.tb_next
    return f"{path}, line {line}" if line else str(path)
