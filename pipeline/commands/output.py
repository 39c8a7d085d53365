"""What every command does with its answer: the screen, JSON, files to write, and progress."""

import json
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from rich.console import Console


JsonOption = Annotated[Path | None, typer.Option("--json", help="The answer as JSON; '-' is standard output.")]

PIPED_WIDTH = 140
"""Columns of what is not written to a terminal: a table is then read by somebody else, or kept."""


def to_screen() -> "Console":
    """Standard output for tables and coloured lines."""
    from rich.console import Console

    return Console(highlight=False, width=None if sys.stdout.isatty() else PIPED_WIDTH)


def write_json(answer: dict[str, Any], file: Path) -> None:
    """Write the answer to a file, in one step, or to standard output for ``-``.

    Raises:
        InputError: the file cannot be written.
    """
    from armdyn import atomic

    text = json.dumps(answer, indent=1, allow_nan=False)
    if file == Path("-"):
        typer.echo(text)
    else:
        atomic.write_text(file, text + "\n")


@contextmanager
def phase_progress() -> Iterator[Callable[[str, float], None]]:
    """Show what is going on and how much of it is done, until the block ends.

    Yields:
        ``show(what, share)``, the share from 0 to 1.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description:<24}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=1.0)

        def show(what: str, share: float) -> None:
            bar.update(task, description=what, completed=share)

        yield show


def check_outputs(*files: Path | None, inputs: Sequence[Path] = ()) -> None:
    """Refuse early what could not be written at the end, or would destroy what was read.

    Args:
        files: to be written, None for none and ``-`` for standard output.
        inputs: recordings and models that are read.

    Raises:
        InputError: a directory is missing, or is given in place of a file; a file is to be written twice or was read.
    """
    from armdyn.errors import InputError

    taken = {file.resolve(): "an input" for file in inputs}
    for file in files:
        if file is None or file == Path("-"):
            continue
        if file.resolve() in taken:
            raise InputError(f"{file} is {taken[file.resolve()]}: choose another file to write")
        taken[file.resolve()] = "also to be written as something else"
        if file.is_dir():
            raise InputError(f"{file} is a directory: give the file to write")
        if not file.absolute().parent.is_dir():
            raise InputError(f"cannot write {file}: there is no directory {file.parent}; choose another place")


@contextmanager
def spinner() -> Iterator[Callable[[str], None]]:
    """Say on standard error what is going on, until the block ends."""
    from rich.console import Console

    with Console(stderr=True).status("reading") as status:
        yield status.update


def command_line() -> str:
    """The command as it was given, for a report that says how to make it again."""
    return shlex.join(["armdyn", *sys.argv[1:]])
