"""Checks of the files that a command will write, before anything is computed."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from armdyn.atomic import is_stream, make_directory
from armdyn.errors import InputError
from armdyn.read_files import check_overwrite

if TYPE_CHECKING:
    from armdyn.run import Run


def check_outputs(*files: Path | None, inputs: Sequence[Path] = ()) -> None:
    """Refuse, before computing, outputs that cannot be written or that would overwrite inputs.

    Args:
        files: files to write, None for no file and ``-`` for standard output.
        inputs: recordings and models that the command reads.

    Raises:
        InputError: a directory is missing, or is given in place of a file; a file is to be written twice or was read.
    """
    taken = {file.resolve(): "an input" for file in inputs}
    for file in files:
        if file is None or file == Path("-"):
            continue
        if is_stream(file):
            continue
        try:
            target = file.resolve(strict=False)
            directory = file.is_dir()
        except (OSError, RuntimeError, ValueError) as error:  # a long name, a null character, a circle of links
            raise InputError(f"cannot write {str(file)!r}: {error}; choose another place") from error
        if target in taken:
            raise InputError(f"{file} is {taken[target]}: choose another file to write")
        check_overwrite(file)
        taken[target] = "also to be written as something else"
        if directory:
            raise InputError(f"{file} is a directory: give the file to write")
        if not target.parent.is_dir():
            raise InputError(f"cannot write {file}: there is no directory {target.parent}; choose another place")


def write_runs(runs: "Mapping[Path, Run]", force: bool) -> None:
    """Write runs as CSV with their sidecars, into directories that are made where they are missing.

    Raises:
        InputError: a file exists already, and `force` is not given, or it cannot be written.
    """
    from armdyn.run import write_run_csv

    for path in runs:
        for file in (path, path.with_suffix(".toml")):
            free_to_write(file, force)
    for path, run in runs.items():
        make_directory(path.parent)
        write_run_csv(run, path)


def free_to_write(file: Path, force: bool) -> None:
    """Refuse to overwrite a file, unless the user requested it.

    Raises:
        InputError: the file exists.
    """
    if file.exists() and not force and not is_stream(file):
        raise InputError(f"{file} is there already: choose another name, or write over it with --force")
