"""Find where a table of text begins: its header may be in a comment, below other lines, above its units, or absent.

The first two successive lines that contain mostly numbers define the separator and the number of cells.
"""

import csv
from contextlib import suppress
from itertools import pairwise

from armdyn.recording.delimited import MISSING_CELLS, separator_of
from pipeline.imports.words import QUANTITY_UNITS, is_unit_like
from urdf.bounds import parse_number, printable_excerpt

COMMENT_MARKS = ("#", "%", "//")
"""First characters of comment lines."""
MAX_LINES_ABOVE_TABLE = 200
"""Largest number of lines above the first row of a table."""
_BRACKETS = " ()[]-"


def single_header_table(text: str) -> tuple[str, bool, list[str]]:
    """Convert the text of a table to one with exactly one header line above its rows.

    Args:
        text: text of the file. The numbers of its rows are kept if there is a line above them.

    Returns:
        The text, whether the file has a header, and sentences on what was left out. Columns without a header are named
        ``column 1``, ``column 2``, ...
    """
    lines = text.split("\n")
    filled = [i for i, line in enumerate(lines) if line.strip()]
    comments = {i for i in filled if lines[i].lstrip().startswith(COMMENT_MARKS)}
    rows = [i for i in filled if i not in comments]
    pairs = pairwise(rows[:MAX_LINES_ABOVE_TABLE])
    first = next((i for i, j in pairs if _is_row(lines[i]) and _is_row(lines[j])), None)
    if first is None or (not comments and rows[1] == first):
        return text, True, []
    separator = separator_of(lines[first])
    width = len(_cells(lines[first], separator))
    above = [(i, _cells(lines[i].strip().lstrip("#%/"), separator, width)) for i in filled if i < first]
    fitting = [(i, cells) for i, cells in above if len(cells) == width and not any(map(is_number, cells))]
    names = fitting[-1][1] if fitting else [f"column {k}" for k in range(1, width + 1)]
    used = {i for i, _ in fitting[-1:]}
    if len(fitting) > 1 and all(map(_is_unit, names)) and any(cell.strip(_BRACKETS) for cell in names):
        units, names = [unit.strip(_BRACKETS) for unit in names], fitting[-2][1]
        names = [f"{name} [{unit}]" if unit else name for name, unit in zip(names, units, strict=True)]
        used = {i for i, _ in fitting[-2:]}
    notes = [f"{len(comments - used)} lines of comment left out"] if comments - used else []
    other = [lines[i].strip() for i, _ in above if i not in used and i not in comments]
    if other:
        notes.append(
            f"lines above the header left out: {printable_excerpt(other[0], 40)!r}" + " ..." * (len(other) > 1)
        )
    for i in {*comments, *(i for i, _ in above)}:
        lines[i] = ""
    head = separator.join(f'"{name}"' if separator in name else name for name in names)
    lines[:first] = [*[""] * (first - 1), head]
    if separator == " ":
        lines = [line.rstrip() for line in lines]
    return "\n".join(lines), bool(fitting), notes


def is_number(cell: str) -> bool:
    """Whether a cell of a table is a number, with a decimal point or comma."""
    try:
        parse_number(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _is_row(line: str) -> bool:
    cells = _cells(line, separator_of(line))
    present = [cell for cell in cells if cell.lower() not in MISSING_CELLS]
    return len(cells) > 1 and bool(present) and 2 * sum(map(is_number, present)) >= len(present)


def _cells(line: str, separator: str, wanted: int = 0) -> list[str]:
    """The cells of a line; a separator that does not give `wanted` cells is replaced by the line's own."""
    parts = line.split() if separator == " " else line.split(separator)
    if '"' in line and separator != " ":
        with suppress(csv.Error):
            parts = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    found = [part.strip().strip('"') for part in parts]
    own = separator_of(line)
    return found if own == separator or len(found) == wanted else _cells(line, own)


def _is_unit(cell: str) -> bool:
    text = cell.strip(_BRACKETS)
    return not text or is_unit_like(text, *(unit for units in QUANTITY_UNITS.values() for unit in units))
