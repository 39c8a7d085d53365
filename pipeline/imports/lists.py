"""Cells of a table that hold lists: each entry becomes a column, named by its number, or by the names beside it.

LeRobot's ``observation.state`` and ``action`` are such columns, and so are ``position`` and ``name`` of joint states
that a script wrote to CSV. A list may be JSON, or as Python, numpy or a logger print it: ``[0.1, -0.2]``,
``[0.1 -0.2]``, ``[0.1; -0.2]``, ``array('d', [0.1, -0.2])``.
"""

import re
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from armdyn.errors import InputError
from armdyn.recording.channels import JOINT_CHANNELS, FloatArray
from pipeline.imports.words import name_words, word_set
from urdf.bounds import (
    MAX_NAME_CHARACTERS,
    MAX_TABLE_CELLS,
    MAX_TABLE_COLUMNS,
    parse_number,
    printable_excerpt,
)

_LIST = re.compile(r"(?:\w+\((?:'\w',)?)?\s*[\[(](?P<inside>[^\[\](){}]*)[\])]\s*(?:,\s*[\w=.]+)?\)?|array\('\w'\)")
_QUOTED = re.compile(r"'[^']*'|\"[^\"]*\"")
_NUMPY_SCALAR = re.compile(r"\bnp\.\w+\(([^()]*)\)")
_BRACKETS = re.compile(r"(^|[,;\t])( *)(\[[^\[\]\"\n]*\])(?= *(?:[,;\t]|$))", re.MULTILINE)
_MISSING = frozenset({"", "nan", "null", "none"})
NAME_WORDS = word_set("name names")
"""Words of the header of a column that names the entries of the lists beside it."""


def list_items(cell: str) -> tuple[str, ...] | None:
    """The entries of a cell that holds a list, as texts without quotes; None where it holds none."""
    match = _LIST.fullmatch(_NUMPY_SCALAR.sub(r"\1", cell).strip())
    if match is None:
        return None
    inside = (match["inside"] or "").strip()
    separator = next((mark for mark in ";," if mark in inside), None)
    if separator is None and inside.startswith(("'", '"')):
        return tuple(quoted[1:-1] for quoted in _QUOTED.findall(inside))
    items = (inside.removesuffix(separator) if separator else inside).split(separator) if inside else []
    return tuple(item.strip().strip("'\"").replace(",", ".") for item in items)


def lists_in(column: str, cells: Mapping[int, str], rows: Sequence[int]) -> dict[int, tuple[str, ...]] | None:
    """The lists in the cells of a column that are not numbers; None where most of these cells hold no list.

    Args:
        column: name of the column, for messages.
        cells: cells that are neither numbers nor empty, by index in `rows`.
        rows: (n,) number of each row, for messages.

    Raises:
        InputError: most cells hold a list, and another one holds something else.
    """
    found = {row: items for row, cell in cells.items() if (items := list_items(cell)) is not None}
    if 2 * len(found) <= len(cells):
        return None
    for row, cell in cells.items():
        if row not in found:
            raise InputError(
                f"row {rows[row]}, column '{printable_excerpt(column)}': '{printable_excerpt(cell, 40)}' is not a list "
                "as in the other rows: correct it, or empty the cell"
            )
    return found


def quoted_lists(text: str, separator: str) -> str:
    """Put quotes around lists in the rows of a table that hold its separator, as in ``0.1,[1.0, 2.0]``."""
    rows = text.find("\n", len(text) - len(text.lstrip()))
    if not separator.strip() or "[" not in text[rows:]:
        return text

    def quoted(match: re.Match[str]) -> str:
        before, blanks, cell = match.groups()
        return f'{before}{blanks}"{cell}"' if separator in cell and before in ("", separator) else match.group()

    return _BRACKETS.sub(quoted, text)


def columns_of_lists(
    lists: Mapping[str, Mapping[int, tuple[str, ...]]], rows: Sequence[int]
) -> tuple[dict[str, dict[str, FloatArray]], list[str]]:
    """Columns of numbers from columns of lists.

    Args:
        lists: by column, the entries of every cell that holds a list, by index in `rows`.
        rows: (n,) number of each row, for messages.

    Returns:
        By column of lists, the numbers (n,) of every new column, nan where a row has no list; and a sentence for each
        column of lists. New columns are called ``position/0``, or ``q.0`` where the list's header is a quantity of
        armdyn's channels; in place of the number stands the entry's name where a column of names has lists of the same
        lengths.

    Raises:
        InputError: a list is longer or shorter than the others, or an entry is not a number.
    """
    words = {column for column, cells in lists.items() if not any(map(_is_number, _entries(cells)))}
    named = {column for column in words if NAME_WORDS & set(name_words(column)) and any(_entries(lists[column]))}
    columns: dict[str, dict[str, FloatArray]] = {}
    notes = []
    for column, cells in lists.items():
        if column in words:
            kind = "lists of text" if any(_entries(cells)) else "empty lists"
            notes += [] if column in named else [f"'{column}' holds {kind}: left out"]
            continue
        names = next((lists[c] for c in lists if c in named and _fits(cells, lists[c])), None)
        if names is None:
            _check_lengths(column, cells, rows)
        joint = "." if column in JOINT_CHANNELS else "/"
        found = columns.setdefault(column, {})
        for row, items in cells.items():
            for place, item in enumerate(items):
                part = f"{column}{joint}{place if names is None else names[row][place]}"
                if part not in found:
                    _check_size(part, len(found), rows, row)
                    found[part] = np.full(len(rows), np.nan)
                found[part][row] = _number(item, column, rows[row])
        notes.append(f"'{column}' holds lists: {_shown(found)}")
    return columns, notes


def _check_size(part: str, count: int, rows: Sequence[int], row: int) -> None:
    """Refuse a new column beside `count` others if its name is not one, or if they would not fit into memory."""
    if len(part) > MAX_NAME_CHARACTERS or not part.isprintable():
        raise InputError(f"row {rows[row]}: '{printable_excerpt(part)}' is not a name of a joint: correct it")
    if count == MAX_TABLE_COLUMNS or count * len(rows) > MAX_TABLE_CELLS:
        raise InputError(f"row {rows[row]}: '{printable_excerpt(part)}' is one of too many numbers: leave some out")


def _entries(cells: Mapping[int, tuple[str, ...]]) -> Iterator[str]:
    return (item for items in cells.values() for item in items)


def _is_number(item: str) -> bool:
    if item.lower() in _MISSING:
        return bool(item)
    try:
        parse_number(item)
    except ValueError:
        return False
    return True


def _number(item: str, column: str, row: int) -> float:
    if item.lower() in _MISSING:
        return np.nan
    try:
        return parse_number(item)
    except ValueError:
        raise InputError(
            f"row {row}, column '{printable_excerpt(column)}': '{printable_excerpt(item, 40)}' in its list is not a "
            "number: correct it, or empty the cell"
        ) from None


def _fits(cells: Mapping[int, tuple[str, ...]], names: Mapping[int, tuple[str, ...]]) -> bool:
    """Whether every list has as many entries as the list of names in its row."""
    return all(not items or len(names.get(row, ())) == len(items) for row, items in cells.items())


def _check_lengths(column: str, cells: Mapping[int, tuple[str, ...]], rows: Sequence[int]) -> None:
    filled = [(row, len(items)) for row, items in cells.items() if items]
    lengths = [length for _, length in filled]
    usual = max(set(lengths), key=lengths.count, default=0)
    wrong = next(((row, length) for row, length in filled if length != usual), None)
    if wrong is not None:
        raise InputError(
            f"row {rows[wrong[0]]}, column '{printable_excerpt(column)}': its list holds {wrong[1]} numbers, where "
            f"others hold {usual}: correct or remove the row, or leave out the column"
        )


def _shown(parts: Mapping[str, FloatArray]) -> str:
    first, *others = parts
    return f"'{first}' to '{others[-1]}'" if others else f"'{first}'"
