"""Run a user's Python file, and report whatever it raises in one line."""

import importlib.util
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

from armdyn.errors import MAX_SHOWN_MESSAGE_LENGTH, ArmdynError, InputError
from urdf.bounds import MAX_TEXT_FILE_BYTES, MIB


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
