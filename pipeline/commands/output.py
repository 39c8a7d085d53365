"""What every command does with its answer for programs."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

JsonOption = Annotated[Path | None, typer.Option("--json", help="The answer as JSON; '-' is standard output.")]


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
