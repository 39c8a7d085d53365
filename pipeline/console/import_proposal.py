"""A proposed mapping of columns to channels, as JSON and on the screen."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import typer

from pipeline.console.screen import borderless_table, screen_console

if TYPE_CHECKING:
    from pipeline.imports.foreign import ForeignRecording
    from pipeline.imports.mapping import ColumnMap

MAX_LISTED_COLUMNS = 8
"""Largest number of columns that a printed list names."""


def column_map_json(found: "ColumnMap") -> dict[str, object]:
    """JSON of a proposed mapping: its time, and channel, unit, reason and open question by column."""
    from pipeline.fields import attributes_as_json

    return {
        "time": {"column": found.time, "unit": found.time_unit, "check": found.check} if found.time else None,
        "columns": {name: attributes_as_json(entry, "channel unit why check") for name, entry in found.entries.items()},
    }


def print_proposal(found: "ColumnMap", recordings: "Sequence[ForeignRecording]") -> None:
    """Print a proposed mapping as a table, its open questions, each once, and the columns that are left out."""
    columns = {name: column for foreign in recordings for name, column in foreign.columns.items()}
    asked: dict[str, list[str]] = {}
    if found.check:
        asked[found.check] = [found.time]
    for column, entry in found.entries.items():
        if entry.check:
            asked.setdefault(entry.check, []).append(column)
    number = {question: i for i, question in enumerate(asked, 1)}

    def reason(why: str, check: str) -> str:
        return "; ".join(part for part in (why, f"CHECK {number[check]}" if check else "") if part)

    table = borderless_table("column", "channel", "unit", "why")
    if found.time:
        table.add_row(found.time, "time", found.time_unit, reason(found.why, found.check))
    for column, entry in found.entries.items():
        table.add_row(column, entry.channel, entry.unit or columns[column].unit, reason(entry.why, entry.check))
    screen_console().print(table)
    for question, names in asked.items():
        typer.echo(f"CHECK {number[question]}: {question} ({_listed(names)})")
    used = {found.time, *found.entries, *(entry.height for entry in found.entries.values())}
    if unused := [name for name in columns if name not in used]:
        typer.echo(f"left out: {_listed(unused)}")


def _listed(names: "Sequence[str]") -> str:
    more = len(names) - MAX_LISTED_COLUMNS
    return ", ".join(names[:MAX_LISTED_COLUMNS]) + (f" and {more} more" if more > 0 else "")
