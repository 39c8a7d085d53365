"""Check the output files of a command before anything is computed."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from armdyn.atomic import is_stream, make_directory
from armdyn.errors import InputError
from armdyn.read_files import check_not_input

if TYPE_CHECKING:
    from armdyn.run import Run


def check_outputs(*files: Path | None, inputs: Sequence[Path] = ()) -> None:
    """Check that the output files of a command can be written and do not overwrite its inputs.

    Args:
        files: output files; None for no file, and ``-`` for standard output.
        inputs: files that the command reads.

    Raises:
        InputError: a file's directory does not exist, a path is a directory, two outputs are the same file, or an
            output is an input.
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
        check_not_input(file)
        taken[target] = "also to be written as something else"
        if directory:
            raise InputError(f"{file} is a directory: give the file to write")
        if not target.parent.is_dir():
            raise InputError(f"cannot write {file}: there is no directory {target.parent}; choose another place")


def write_runs(runs: "Mapping[Path, Run]", force: bool) -> None:
    """Write runs to CSV files, each with a TOML file of the same stem; missing directories are created.

    Args:
        runs: runs by the path of their CSV file.
        force: whether existing files may be overwritten.

    Raises:
        InputError: a file exists already and `force` is False, or a file cannot be written.
    """
    from armdyn.run import write_run_csv

    for path in runs:
        for file in (path, path.with_suffix(".toml")):
            check_overwrite(file, force)
    for path, run in runs.items():
        make_directory(path.parent)
        write_run_csv(run, path)


def check_overwrite(file: Path, force: bool) -> None:
    """Check that a file does not exist, or may be overwritten (`force`).

    Raises:
        InputError: the file exists and `force` is False.
    """
    if file.exists() and not force and not is_stream(file):
        raise InputError(f"{file} is there already: choose another name, or write over it with --force")
