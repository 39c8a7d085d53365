"""Run a user's Python file, and report whatever it raises in one line."""

import importlib.util
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

from armdyn.errors import ArmdynError, InputError
from urdf.bounds import MAX_TEXT_FILE_BYTES, MIB

MAX_EXCEPTION_LENGTH = 300
"""Largest number of characters of an exception's message."""


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
    with faults_in(path), warnings.catch_warnings():
        warnings.simplefilter("ignore", SyntaxWarning)  # style warnings are the user's own affair
        spec.loader.exec_module(module)
    return module


@contextmanager
def faults_in(path: Path) -> Iterator[None]:
    """Turn everything that a user's file raises into an `InputError` of one line, with the file and line."""
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
        placed = said if said.startswith(str(path)) else f"{place_of(error, path)}: {said[:MAX_EXCEPTION_LENGTH]}"
        raise InputError(placed) from error


def place_of(error: BaseException | None, path: Path) -> str:
    """The path of the file, with the last of its lines in an exception's traceback, where there is one."""
    line = error.lineno if isinstance(error, SyntaxError) else None
    trace = error.__traceback__ if error is not None else None
    while trace is not None:
        if Path(trace.tb_frame.f_code.co_filename) == path:
            line = trace.tb_lineno
        trace = trace.tb_next
    return f"{path}, line {line}" if line else str(path)
