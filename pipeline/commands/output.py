"""What every command does with its answer for programs."""

import json
import sys
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
