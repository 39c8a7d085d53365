"""Print the answer of a command on the screen, write it as JSON, and show the command's progress."""

import json
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from io import TextIOWrapper
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, Protocol

import typer

from armdyn.document import MAX_CARD_ROWS
from armdyn.errors import InputError
from armdyn.quoting import shell_quoted_command
from pipeline.console.description_warnings import collected_warnings

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Column, Table

    from armdyn.document import Document


PIPED_OUTPUT_WIDTH = 140
"""Width of the output in characters if it is not written to a terminal."""


def screen_console() -> "Console":
    """Make a console on standard output, in which square brackets such as in ``[m]`` are text, not a style.

    Characters that the encoding of the terminal lacks are printed as question marks.
    """
    from rich.console import Console

    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")
    return Console(highlight=False, markup=False, width=None if sys.stdout.isatty() else PIPED_OUTPUT_WIDTH)


def borderless_table(*heads: "str | Column") -> "Table":
    """Make an empty table for the screen, without lines, from the headings of its columns."""
    from rich.table import Table

    return Table(*heads, box=None, header_style="dim")


def print_document(document: "Document") -> None:
    """Print a document on the screen: verdict, key figures, tables and notes; sections with charts only are skipped."""
    from rich.table import Column

    console = screen_console()
    console.print(document.verdict, style="bold", soft_wrap=True)
    for figure in document.key_figures:
        note = f" ({figure.note})" if figure.note else ""
        console.print(f"{figure.name}: {figure.value}{note}", soft_wrap=True)
    for section in document.sections:
        tables = [table for table in section.tables if len(table)]
        sentence = "" if section.sentence in document.verdict else section.sentence
        if not tables and (section.charts or not sentence):
            continue
        console.print(f"\n{section.title}", style="bold")
        if sentence:
            console.print(sentence, soft_wrap=True)
        for table in tables:
            made = borderless_table(
                *(Column(column.heading, overflow="fold") for column in table.columns_kept_when_narrow)
            )
            most = len(table) if table.name else MAX_CARD_ROWS
            for row in list(zip(*(column.texts for column in table.columns_kept_when_narrow), strict=True))[:most]:
                made.add_row(*row)
            console.print(made)
            if len(table) > most:
                console.print(f"and {len(table) - most} more: see the report or the JSON")
            if table.caption:
                console.print(table.caption, style="dim")
    for note in document.notes:
        console.print(note, style="yellow", soft_wrap=True)


def finish_command(
    document: "Document",
    answer: Callable[[], dict[str, Any]],
    json_file: Path | None,
    report: Path | None = None,
    page: "Callable[[], Document] | None" = None,
    written: Iterable[str] = (),
    *,
    failed: bool = False,
) -> None:
    """Write the report and the JSON of a command, and print its answer on the screen.

    Args:
        document: answer for the screen.
        answer: function that returns the JSON output.
        json_file: file of the JSON; None for none; ``-`` for standard output, on which nothing else is then printed.
        report: HTML file; None for none.
        page: function that returns the document for the report, with charts.
        written: a sentence for each other file that was written.
        failed: whether the command ends with exit status 1.

    Raises:
        InputError: a file cannot be written.
        Exit: with status 1 if `failed`.
    """
    if report is not None and page is not None:
        save_report(page(), report)
    if write_json_if_file_given(json_file, answer):
        print_document(document)
        if document.sections:
            typer.echo("")
        for line in written:
            typer.echo(line)
        if report is not None:
            typer.echo(f"report {report}")
        for step in document.next_steps:
            typer.echo(f"{step.what}: {step.command}")
    if failed:
        raise typer.Exit(1)


def save_report(document: "Document", file: Path) -> None:
    """Write a document to an HTML file, which shows the command that made it.

    Raises:
        InputError: the file cannot be written.
    """
    from dataclasses import replace

    from pipeline.report.page import write_page

    write_page(replace(document, command=shell_quoted_command(*sys.argv[1:])), file)


def write_json(answer: dict[str, Any], file: Path) -> None:
    """Write the JSON output of a command to a file, or to standard output for ``-``, with the collected warnings.

    Raises:
        InputError: the file cannot be written.
    """
    from armdyn import atomic

    said = {"warnings": list(collected_warnings())} if collected_warnings() else {}
    text = json.dumps({**answer, **said}, indent=1, allow_nan=False)
    if file == Path("-"):
        if sys.__stdout__ is None:
            raise InputError("cannot write to standard output: it is closed; give --json a file")
        try:
            typer.echo(text)
            sys.stdout.flush()
        except BrokenPipeError:
            # The reader, such as `head`, closed the pipe; Python's own last flush must not fail either.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        except (OSError, ValueError, AttributeError) as error:  # a full disk, or a closed stream (two kinds)
            why = getattr(error, "strerror", None) or "it is closed"
            raise InputError(f"cannot write to standard output: {why}; give --json a file") from error
    else:
        atomic.write_text(file, text + "\n")


def write_json_if_file_given(json_file: Path | None, answer: Callable[[], dict[str, Any]]) -> bool:
    """Write the JSON output of a command if a file was given.

    Args:
        json_file: the file; None for none, ``-`` for standard output.
        answer: function that returns the JSON output.

    Returns:
        Whether text may be printed on standard output, because JSON was not written there.

    Raises:
        InputError: the file cannot be written.
    """
    if json_file is not None:
        write_json(answer(), json_file)
    return json_file != Path("-")


class ProgressDisplay(Protocol):
    """Function that shows a command's progress."""

    def __call__(self, what: str, share: float | None = None) -> None:
        """Show the present activity, and the share of it that is done, from 0 to 1; None if the share is unknown."""


PROGRESS_COUNT_PATTERN = re.compile(r"(\d+) of (\d+) ")
"""Pattern of the first words of a message such as ``3 of 12 candidates tried``, for which a bar is shown."""


@contextmanager
def progress_display() -> Iterator[ProgressDisplay]:
    """Show a command's activity, progress and elapsed time on the terminal during the ``with`` block.

    Yields:
        The function that shows an activity. For a text such as ``"3 of 12 candidates tried"`` it also shows a bar and
        the remaining time.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(24),
        TextColumn("{task.fields[left]}", markup=False),
        TimeElapsedColumn(),
    )
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("reading", total=None, left="")
        phase, began = "", monotonic()

        def say(what: str, share: float | None = None) -> None:
            nonlocal phase, began
            counted, left = PROGRESS_COUNT_PATTERN.match(what), ""
            done, total = (0.0, None) if share is None else (share, 1.0)
            if counted is not None:
                done, total = float(counted[1]), float(counted[2])
                kind = what[counted.end() :].partition(",")[0]
                if kind != phase or done == 0:
                    phase, began = kind, monotonic()
                left = remaining_time_text((monotonic() - began) * (total - done) / done) if done else ""
            else:
                phase = ""
            bar.update(task, description=what, total=total, completed=done, left=left)

        yield say


def remaining_time_text(seconds: float) -> str:
    """Text of a remaining time [s], rounded, such as ``about 40 s left``."""
    if seconds < 10.0:
        return "a few seconds left"
    return f"about {10 * round(seconds / 10)} s left" if seconds < 90.0 else f"about {round(seconds / 60)} min left"
